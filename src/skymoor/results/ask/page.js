// Clicks and drags fill in number fields, and fields draw marks. Without this script the fields do the same.
(() => {
  "use strict";
  const NAMES = {
    area: ["area_west", "area_south", "area_east", "area_north"],
    point: ["point_u", "point_v", "point_lat", "point_lon"],
    length: ["length_u0", "length_v0", "length_u1", "length_v1"],
  };
  document.querySelectorAll("form").forEach((form) => {
    const field = (name) => form.elements.namedItem(name);
    const put = (name, value, digits) => { field(name).value = value.toFixed(digits); };
    const read = (names) => {
      const values = names.map((name) => (field(name) ? field(name).value.trim() : ""));
      return values.every((one) => one && Number.isFinite(Number(one))) ? values.map(Number) : null;
    };
    const map = form.querySelector('[data-kind="map"]');
    const render = form.querySelector('[data-kind="render"]');
    const corners = form.dataset.map.split(" ").map(Number); // latitude and longitude: NW, NE, SW, SE
    const extent = map ? map.dataset.extent.split(" ").map(Number) : [];
    const mode = () => form.querySelector('[name="mode"]:checked')?.value || "";
    const at = (svg, event) => {
      const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      const box = svg.viewBox.baseVal;
      return [
        Math.min(Math.max(point.x, box.x), box.x + box.width),
        Math.min(Math.max(point.y, box.y), box.y + box.height),
      ];
    };
    const share = ([x, y]) => [(x - extent[0]) / (extent[2] - extent[0]), (extent[3] + y) / (extent[3] - extent[1])];
    const placed = (xy) => {
      const [a, b] = share(xy);
      return [0, 1].map((k) => (1 - b) * ((1 - a) * corners[k] + a * corners[2 + k]) + b * ((1 - a) * corners[4 + k] + a * corners[6 + k]));
    };
    const onMap = (lat, lon) => { // the other way, by a few steps of Newton: the corners are nearly a rectangle
      let xy = [(extent[0] + extent[2]) / 2, -(extent[1] + extent[3]) / 2];
      for (let k = 0; k < 5; k += 1) {
        const [p, q] = placed(xy);
        xy = [
          xy[0] + ((lon - q) / (corners[3] - corners[1])) * (extent[2] - extent[0]),
          xy[1] + ((lat - p) / (corners[4] - corners[0])) * (extent[3] - extent[1]),
        ];
      }
      return xy;
    };
    const mark = (svg, path, dot) => {
      if (!svg) return;
      const drawn = svg.querySelector(".mark");
      drawn.setAttribute("d", path);
      drawn.classList.toggle("dot", Boolean(dot));
    };
    const show = () => {
      const [area, point, line] = [read(NAMES.area), read(NAMES.point), read(NAMES.length)];
      const spot = point && map ? onMap(point[2], point[3]) : null;
      if (area && map) {
        const [low, high] = [onMap(area[1], area[0]), onMap(area[3], area[2])];
        mark(map, `M${low[0]} ${low[1]}H${high[0]}V${high[1]}H${low[0]}Z`);
      } else mark(map, spot ? `M${spot[0]} ${spot[1]}h0` : "", true);
      if (line) mark(render, `M${line[0]} ${line[1]}L${line[2]} ${line[3]}`);
      else mark(render, field("point_u")?.value && field("point_v")?.value ? `M${Number(field("point_u").value)} ${Number(field("point_v").value)}h0` : "", true);
    };
    const draw = (svg, begin, end) => {
      const kind = mode();
      if (kind === "area" && svg === map) {
        const [p, q] = [placed(begin), placed(end)];
        [Math.min(p[1], q[1]), Math.min(p[0], q[0]), Math.max(p[1], q[1]), Math.max(p[0], q[0])]
          .forEach((value, k) => put(NAMES.area[k], value, 6));
      } else if (kind === "point" && svg === map) {
        placed(end).forEach((value, k) => put(NAMES.point[2 + k], value, 7));
      } else if (kind === "point") {
        end.forEach((value, k) => put(NAMES.point[k], value, 1));
      } else if (kind === "length" && svg === render) {
        [...begin, ...end].forEach((value, k) => put(NAMES.length[k], value, 1));
      } else return;
      show();
    };
    [map, render].filter(Boolean).forEach((svg) => {
      let begin = null;
      svg.addEventListener("pointerdown", (event) => {
        if (!mode()) return;
        begin = at(svg, event);
        svg.setPointerCapture?.(event.pointerId);
        event.preventDefault();
      });
      svg.addEventListener("pointermove", (event) => { if (begin && mode() !== "point") draw(svg, begin, at(svg, event)); });
      svg.addEventListener("pointerup", (event) => { if (begin) draw(svg, begin, at(svg, event)); begin = null; });
      svg.addEventListener("pointercancel", () => { begin = null; });
    });
    form.addEventListener("input", () => {
      [map, render].filter(Boolean).forEach((svg) => svg.classList.toggle("on", Boolean(mode())));
      show();
    });
    show();
  });
  document.getElementById("error")?.scrollIntoView();
})();
