// Tiles of a web map behind the chart. Nothing is asked for until the reader wants it: this is called by the click.
const background = (chart, place, view, scale) => {
  "use strict";
  const svg = (name) => document.createElementNS("http://www.w3.org/2000/svg", name);
  const [lat0, lon0] = [Number(place.lat), Number(place.lon)], rad = Math.PI / 180, most = 48, known = new Map();
  // WGS 84: radii of curvature along the meridian and across it, for local metres that are right to centimetres.
  const e2 = 0.00669437999014, [sin, cos] = [Math.sin(lat0 * rad), Math.cos(lat0 * rad)], w = 1 - e2 * sin * sin;
  const across = 6378137 / Math.sqrt(w), along = (across * (1 - e2)) / w;
  const metres = (lat, lon) => {
    const [b, l] = [(lat - lat0) * rad, (lon - lon0) * rad];
    return [across * cos * l - along * sin * b * l, -(along * b + (across * sin * cos * l * l) / 2)];
  };
  const corner = (x, y, z) => metres(Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / 2 ** z))) / rad, (x / 2 ** z) * 360 - 180);
  const tile = (x, y, z) => {
    const lat = (lat0 - y / along / rad) * rad;
    return [((lon0 + x / (across * cos) / rad + 180) / 360) * 2 ** z, ((1 - Math.asinh(Math.tan(lat)) / Math.PI) / 2) * 2 ** z];
  };
  const group = chart.insertBefore(svg("g"), chart.firstChild);
  group.id = "tiles";
  const ortho = document.getElementById("ortho");
  if (ortho) ortho.classList.add("thin");
  const failed = () => { document.getElementById("lost").hidden = false; };
  const put = (x, y, z) => {
    const [[x0, y0], [x1, y1], [x2, y2]] = [corner(x, y, z), corner(x + 1, y, z), corner(x, y + 1, z)], image = svg("image");
    image.setAttribute("transform", `matrix(${[x1 - x0, y1 - y0, x2 - x0, y2 - y0, x0, y0].join(" ")})`);
    for (const [name, value] of [["width", 1], ["height", 1], ["preserveAspectRatio", "none"]]) image.setAttribute(name, value);
    image.addEventListener("error", failed);
    image.setAttribute("href", place.tiles.replace("{z}", z).replace("{x}", x).replace("{y}", y));
    return group.appendChild(image);
  };
  return () => {
    const [west, top, width, height] = view();
    let z = Math.round(Math.log2((2 * Math.PI * 6378137 * cos) / (256 * scale())));
    z = Math.min(Math.max(z, 0), Number(place.finest)) + 1;
    let range;
    do {
      z -= 1;
      const [a, b] = [tile(west, top, z), tile(west + width, top + height, z)], last = 2 ** z - 1;
      range = [a[0], a[1], b[0], b[1]].map((one) => Math.min(Math.max(Math.floor(one), 0), last));
    } while (z > 0 && (range[2] - range[0] + 1) * (range[3] - range[1] + 1) > most);
    for (const [key, image] of known) if (!key.startsWith(z + "/")) { image.remove(); known.delete(key); }
    for (let x = range[0]; x <= range[2]; x += 1)
      for (let y = range[1]; y <= range[3]; y += 1) {
        const key = [z, x, y].join("/");
        if (!known.has(key)) known.set(key, put(x, y, z));
      }
  };
};
// The map moves and tells; the slider uncovers. Without this script all figures are still there.
(() => {
  "use strict";
  // Heads of tables become buttons that sort: numbers by value, what has none last in both directions.
  const value = (row, k) => {
    const text = row.cells[k].textContent.trim();
    const figure = Number(text.replace("−", "-"));
    return text === "" || text === "–" ? null : Number.isNaN(figure) ? text : figure;
  };
  const compare = (a, b) =>
    typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true });
  document.querySelectorAll("table.sortable").forEach((table) => {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, k) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = head.textContent;
      head.replaceChildren(button);
      head.setAttribute("aria-sort", "none");
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        heads.forEach((one) => one.setAttribute("aria-sort", "none"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const body = table.tBodies[0], rows = [...body.rows].map((row) => [value(row, k), row]);
        rows.sort(([a], [b]) => (a === null) - (b === null) || (a === null ? 0 : (down ? -1 : 1) * compare(a, b)));
        body.append(...rows.map(([, row]) => row));
      });
    });
  });
  const chart = document.getElementById("chart");
  const slider = document.getElementById("slider");
  if (slider) {
    const pair = document.querySelector(".pair");
    const uncover = () => pair.style.setProperty("--x", slider.value + "%");
    const follow = (event) => {
      const box = pair.getBoundingClientRect();
      slider.value = String((100 * (event.clientX - box.left)) / box.width);
      uncover();
    };
    slider.addEventListener("input", uncover);
    pair.addEventListener("pointerdown", follow);
    pair.addEventListener("pointermove", (event) => { if (event.buttons) follow(event); });
    pair.addEventListener("dragstart", (event) => event.preventDefault());
    uncover();
  }
  if (!chart) return;
  const frame = chart.parentElement;
  const tip = document.getElementById("tip");
  const ruler = document.getElementById("ruler");
  const whole = chart.dataset.box.split(" ").map(Number);
  let box = whole.slice();
  frame.classList.add("scripted"); // the ruler follows the zoom, and the bar of the whole map is not needed
  const scale = () => Math.max(box[2] / chart.clientWidth, box[3] / chart.clientHeight); // metres per pixel
  let laid = () => {}; // lays the background map anew, once there is one
  const show = () => {
    chart.setAttribute("viewBox", box.join(" "));
    laid();
    const wish = 110 * scale();
    const power = 10 ** Math.floor(Math.log10(wish));
    const metres = [5, 2, 1].map((digit) => digit * power).find((one) => one <= wish) || power;
    ruler.style.width = metres / scale() + "px";
    ruler.firstElementChild.textContent = metres >= 1000 ? metres / 1000 + " km" : metres + " m";
  };
  const at = (event) => {
    const inside = chart.getBoundingClientRect();
    const [cx, cy] = [inside.left + inside.width / 2, inside.top + inside.height / 2];
    return [box[0] + box[2] / 2 + (event.clientX - cx) * scale(), box[1] + box[3] / 2 + (event.clientY - cy) * scale()];
  };
  const zoom = (factor, centre) => {
    if (!factor) box = whole.slice();
    else {
      const [x, y] = centre || [box[0] + box[2] / 2, box[1] + box[3] / 2];
      const bounded = Math.min(Math.max(factor, (whole[2] / 400) / box[2]), (whole[2] * 2) / box[2]);
      box = [x - (x - box[0]) * bounded, y - (y - box[1]) * bounded, box[2] * bounded, box[3] * bounded];
    }
    show();
  };
  document.querySelectorAll("[data-zoom]").forEach((one) => one.addEventListener("click", () => zoom(Number(one.dataset.zoom))));
  // The wheel belongs to the page until the map is in use: nobody shall be caught while scrolling past.
  chart.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== chart) return;
    event.preventDefault();
    zoom(1.0016 ** event.deltaY, at(event));
  }, { passive: false });
  const held = new Map();
  chart.addEventListener("pointerdown", (event) => {
    chart.focus({ preventScroll: true });
    held.set(event.pointerId, [event.clientX, event.clientY]);
    if (!event.target.dataset.name) chart.setPointerCapture(event.pointerId);
  });
  chart.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== event.pointerId)[1];
      const away = (one) => Math.hypot(one[0] - other[0], one[1] - other[1]) || 1;
      zoom(away(before) / away([event.clientX, event.clientY]), at({ clientX: other[0], clientY: other[1] }));
    } else {
      box[0] -= (event.clientX - before[0]) * scale();
      box[1] -= (event.clientY - before[1]) * scale();
      show();
    }
    held.set(event.pointerId, [event.clientX, event.clientY]);
  });
  ["pointerup", "pointercancel"].forEach((name) => chart.addEventListener(name, (event) => held.delete(event.pointerId)));
  chart.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (step) { box[0] += (step[0] * box[2]) / 10; box[1] += (step[1] * box[3]) / 10; show(); }
    else if (event.key === "+" || event.key === "=") zoom(0.7);
    else if (event.key === "-") zoom(1.43);
    else return;
    event.preventDefault();
  });
  const tell = (event) => {
    document.querySelectorAll(".dot.on").forEach((one) => one.classList.remove("on"));
    const dot = event.target.closest("[data-name]");
    tip.hidden = !dot;
    if (!dot) return;
    dot.classList.add("on");
    const name = document.createElement("b");
    name.textContent = dot.dataset.name;
    tip.replaceChildren(name, dot.dataset.says);
    const outer = frame.getBoundingClientRect();
    tip.style.left = Math.max(0, Math.min(event.clientX - outer.left + 14, outer.width - tip.offsetWidth)) + "px";
    tip.style.top = Math.max(0, Math.min(event.clientY - outer.top + 14, outer.height - tip.offsetHeight)) + "px";
  };
  chart.addEventListener("pointerover", tell);
  chart.addEventListener("click", tell);
  chart.addEventListener("pointerleave", tell);
  document.getElementById("rings").addEventListener("change", (event) => frame.classList.toggle("no-rings", !event.target.checked));
  document.getElementById("relative").addEventListener("change", (event) => frame.classList.toggle("show-relative", event.target.checked));
  window.addEventListener("resize", show);
  const basemap = document.getElementById("basemap");
  basemap.hidden = false; // without scripts it could do nothing
  basemap.addEventListener("click", () => {
    laid = background(chart, basemap.dataset, () => box, scale);
    basemap.hidden = true;
    const credit = document.getElementById("credit");
    credit.querySelector("a").href = basemap.dataset.terms;
    credit.hidden = false;
    laid();
  });
  window.addEventListener("beforeprint", () => zoom(0)); // the printed scale bar is that of the whole map
  show();
})();
// What is folded away is printed as well.
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => (one.open = true)));
