# SPDX-License-Identifier: Apache-2.0
"""What other programs get of a run, opened by readers that share no code with the writers."""

from __future__ import annotations

import io
import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import cv2
import laspy
import numpy as np
import pycolmap
import pyogrio.raw
import pytest
import rasterio
import trimesh
from PIL import ExifTags, Image
from plyfile import PlyData
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from skymoor.cli.main import main
from skymoor.errors import BackendUnavailable, InputError
from skymoor.results.export import chosen_formats, export
from skymoor.results.formats import cameras_kml, odm_geo, photo_with_position, position_xmp
from skymoor.results.formats._registry import FORMATS
from skymoor.results.formats._source import Source
from skymoor.results.formats.exif import gps_tags
from skymoor.results.formats.geopackage import write_geopackage
from skymoor.results.read import Result
from skymoor.results.tables import CameraRow
from skymoor.types import Array
from support.exported_run import FRAME, LENS, cameras, points, write_run

MILLIMETRE = 1e-3


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of five photos, of which the last is in the model and has no place."""
    return write_run(tmp_path_factory.mktemp("exports"))


@pytest.fixture(scope="module")
def out(run: Path) -> Path:
    """All formats of the run."""
    target = run.parent / "out"
    assert main(["export", str(run), "--to", "all", "--out", str(target), "--quiet"]) == 0
    return target


def _ecef(lon: float, lat: float, height: float) -> Array:
    """By the textbook, not by PROJ."""
    a, e2 = 6378137.0, 0.0066943799901413165
    lat, lon = np.radians(lat), np.radians(lon)
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    across = (n + height) * np.cos(lat)
    return np.array([across * np.cos(lon), across * np.sin(lon), (n * (1 - e2) + height) * np.sin(lat)])


def _enu(lon: float, lat: float, height: float) -> Array:
    s, c = np.sin(np.radians(FRAME.lat_deg)), np.cos(np.radians(FRAME.lat_deg))
    sl, cl = np.sin(np.radians(FRAME.lon_deg)), np.cos(np.radians(FRAME.lon_deg))
    axes = np.array([[-sl, cl, 0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])
    return np.asarray(axes @ (_ecef(lon, lat, height) - _ecef(FRAME.lon_deg, FRAME.lat_deg, FRAME.height_m)))


def _assert_cameras(lonlatheight: object) -> None:
    found = np.array([_enu(*place) for place in lonlatheight])  # type: ignore[attr-defined]
    np.testing.assert_allclose(found, [camera.centre for camera in cameras()[:4]], atol=MILLIMETRE)


def test_every_format_says_what_its_heights_are(out: Path) -> None:
    assert {path.name for path in out.iterdir()} == set(FORMATS)
    for name in FORMATS:
        told = json.loads((out / name / "export.json").read_text())
        assert told["heights"]
        assert all((out / name / file).is_file() for file in told["files"])


@pytest.mark.parametrize("kind", ["bin", "text"])
def test_colmap_models_project_their_points_to_where_they_were_seen(out: Path, kind: str) -> None:
    model = pycolmap.Reconstruction(str(out / "colmap" / kind / "airborne_0"))
    assert sorted(image.name for image in model.images.values()) == [camera.image for camera in cameras()[:4]]
    assert model.compute_num_observations() > 100
    model.update_point_3d_errors()
    assert max(point.error for point in model.points3D.values()) < 0.01
    told = json.loads((out / "colmap" / kind / "airborne_0" / "georeference.json").read_text())
    assert told["enu_origin"]["height"] == FRAME.height_m


def test_nerfstudio_cameras_project_by_opencv(out: Path) -> None:
    told = json.loads((out / "nerfstudio" / "transforms.json").read_text())
    assert told["applied_transform"] == np.eye(4)[:3].tolist()
    assert [frame["file_path"].rpartition("/")[2] for frame in told["frames"]] == [
        "p0.jpg",
        "p1.jpg",
        "p2.jpg",
        "p3.png",
    ]
    for frame, camera in zip(told["frames"], cameras()[:4], strict=True):
        assert (out / "nerfstudio" / frame["file_path"]).is_file()
        assert (frame["w"], frame["h"]) == (LENS.width, LENS.height)
        cam_from_world = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(np.array(frame["transform_matrix"]))
        turn, _ = cv2.Rodrigues(cam_from_world[:3, :3])
        lens = np.array([[frame["fl_x"], 0, frame["cx"]], [0, frame["fl_y"], frame["cy"]], [0, 0, 1]])
        brown = np.array([frame[name] for name in ("k1", "k2", "p1", "p2")])
        px, _ = cv2.projectPoints(points(), turn, cam_from_world[:3, 3], lens, brown)
        want = camera.intrinsics.px_from_cam(camera.cam_from_world.apply(points()))
        np.testing.assert_allclose(px[:, 0], want, atol=0.01)


def test_laz_is_the_cloud_with_its_crs(out: Path) -> None:
    cloud = laspy.read(out / "laz" / "pointcloud.laz")
    assert "19S" in cloud.header.parse_crs().name
    place = Transformer.from_crs("EPSG:32719", "EPSG:4326", always_xy=True).transform(cloud.x, cloud.y)
    found = [_enu(*one) for one in zip(*place, cloud.z, strict=True)]
    np.testing.assert_allclose(found, points(), atol=1.5 * MILLIMETRE)  # it counts in millimetres


@pytest.mark.parametrize("name", ["ortho.tif", "dsm.tif"])
def test_cogs_are_laid_out_as_such_and_hold_the_same(run: Path, out: Path, name: str) -> None:
    with rasterio.open(out / "cog" / name) as cog, rasterio.open(run / name) as plain:
        assert cog.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert cog.crs.to_epsg() == 32719
        assert cog.transform == plain.transform
        np.testing.assert_array_equal(cog.read(), plain.read())
        if name == "dsm.tif":
            assert cog.tags()["VERTICAL_DATUM"] == "ellipsoid"
            assert cog.nodata == plain.nodata


def test_a_damaged_raster_of_the_run_is_told(tmp_path: Path) -> None:
    folder = write_run(tmp_path)
    for content in (b"", (folder / "confidence.tif").read_bytes()[:500]):
        (folder / "confidence.tif").write_bytes(content)
        with pytest.raises(InputError, match=r"confidence\.tif: cannot be copied"):
            export(Result.read(folder), ["cog"], tmp_path / "out", lambda _: None)
        assert not (tmp_path / "out/cog").exists()


@pytest.mark.parametrize(
    ("name", "product"), [("copc", "pointcloud.laz"), ("ply", "pointcloud.laz"), ("gltf", "dsm.tif")]
)
def test_a_damaged_product_of_the_run_is_told(name: str, product: str, tmp_path: Path) -> None:
    folder = write_run(tmp_path)
    content = (folder / product).read_bytes()
    for damaged in (b"", content[: len(content) // 3], b"?" * 400):
        (folder / product).write_bytes(damaged)
        with pytest.raises(InputError, match=f"cannot be written as {name}"):
            export(Result.read(folder), [name], tmp_path / "out", lambda _: None)
        assert not (tmp_path / "out" / name).exists()


def test_a_large_cog_has_overviews(tmp_path: Path) -> None:
    from skymoor.results.formats import write_cog

    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", width=700, height=600, count=1, dtype="uint8", crs="EPSG:32719",
        transform=rasterio.Affine(1, 0, 5e5, 0, -1, 6e6),
    ) as raster:  # fmt: skip
        raster.write(np.ones((1, 600, 700), np.uint8))
    write_cog(tmp_path / "a.tif", tmp_path / "b.tif")
    with rasterio.open(tmp_path / "b.tif") as cog:
        assert cog.overviews(1)


def test_geojson_has_longitude_first(out: Path) -> None:
    told = json.loads((out / "geojson" / "cameras.geojson").read_text())
    _assert_cameras([feature["geometry"]["coordinates"] for feature in told["features"]])


def test_geopackage_opens_in_gdal_with_longitude_first(out: Path) -> None:
    meta, _, marks, fields = pyogrio.raw.read(out / "gpkg" / "cameras.gpkg", layer="cameras")
    assert meta["crs"] == "EPSG:4979"
    assert "Point" in meta["geometry_type"]
    _assert_cameras([struct.unpack("<ddd", bytes(one)[5:]) for one in marks])
    columns = dict(zip(meta["fields"], fields, strict=True))
    assert list(columns["image"]) == [camera.image for camera in cameras()[:4]]
    np.testing.assert_allclose(columns["ce90"], 2.1)


def test_kml_without_a_geoid_gives_no_altitude(out: Path) -> None:
    _, _, marks, _ = pyogrio.raw.read(out / "kml" / "cameras.kml")
    text = (out / "kml" / "cameras.kml").read_text()
    assert len(marks) == 4
    assert ("clampToGround" in text) != ("absolute" in text)


def test_kml_writes_longitude_latitude_altitude() -> None:
    row = CameraRow("a & b.jpg", "airborne", 0, "REGISTERED", -33.5, -70.25, 640.0)
    space = {"k": "http://www.opengis.net/kml/2.2"}
    root = ET.fromstring(cameras_kml([row], [612.5]))
    assert root.findtext(".//k:coordinates", namespaces=space) == "-70.2500000000,-33.5000000000,612.5000"
    assert root.findtext(".//k:altitudeMode", namespaces=space) == "absolute"
    assert root.findtext(".//k:Placemark/k:name", namespaces=space) == "a & b.jpg"
    clamped = ET.fromstring(cameras_kml([row], None))
    assert clamped.findtext(".//k:coordinates", namespaces=space) == "-70.2500000000,-33.5000000000"
    assert clamped.findtext(".//k:altitudeMode", namespaces=space) == "clampToGround"


def test_ply_holds_metres_and_names_its_origin(out: Path) -> None:
    cloud = PlyData.read(out / "ply" / "pointcloud.ply")
    xyz = np.column_stack([cloud["vertex"][axis] for axis in "xyz"])
    np.testing.assert_allclose(xyz, points(), atol=1.5 * MILLIMETRE)
    assert any("-33.5" in comment and "-70.25" in comment for comment in cloud.comments)
    assert any("ellipsoid" in comment for comment in cloud.comments)
    assert set(cloud["vertex"]["red"]) == {90}


def test_the_tileset_puts_the_mesh_on_the_globe(run: Path, out: Path) -> None:
    mesh = trimesh.load(out / "gltf" / "model.glb", force="mesh", process=False)
    root = json.loads((out / "gltf" / "tileset.json").read_text())["root"]
    transform = np.array(root["transform"]).reshape(4, 4).T
    turned = np.asarray(mesh.vertices)[:, [0, 2, 1]] * [1, -1, 1]  # as viewers do: y up to z up
    found = turned @ transform[:3, :3].T + transform[:3, 3]
    with rasterio.open(run / "dsm.tif") as dsm:
        known = dsm.read_masks(1) > 0
        rows, columns = np.nonzero(known)
        x, y = rasterio.transform.xy(dsm.transform, rows, columns)
        height = dsm.read(1)[known].astype(float)
    lon, lat = Transformer.from_crs("EPSG:32719", "EPSG:4326", always_xy=True).transform(x, y)
    want = np.array([_ecef(*one) for one in zip(lon, lat, height, strict=True)])
    assert len(found) > 0.95 * len(want)
    gap = [np.linalg.norm(want - one, axis=1).min() for one in found[::997]]
    assert max(gap) < MILLIMETRE
    box = np.array(root["boundingVolume"]["box"])
    assert (np.abs(turned - box[:3]) <= np.diag(box[3:].reshape(3, 3)) + MILLIMETRE).all()
    assert (mesh.face_normals[:, 1] > 0).all()  # seen from above


def test_exif_copies_keep_pixels_and_say_where(run: Path, out: Path) -> None:
    places = []
    for camera in cameras()[:3]:
        original = (run.parent / camera.image).read_bytes()
        copy = (out / "exif" / camera.image).read_bytes()
        assert original[original.index(b"\xff\xdb") :] == copy[copy.index(b"\xff\xdb") :]  # from the first table on
        exif = Image.open(io.BytesIO(copy)).getexif()
        assert exif[ExifTags.Base.Make] == "Acme"
        assert exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ISOSpeedRatings] == 200
        gps = {ExifTags.GPS(tag).name: value for tag, value in exif.get_ifd(ExifTags.IFD.GPSInfo).items()}
        assert (gps["GPSLatitudeRef"], gps["GPSLongitudeRef"], gps["GPSAltitudeRef"]) == ("S", "W", b"\0")
        assert float(gps["GPSHPositioningError"]) == pytest.approx(2.1)
        lat, lon = (
            -sum(float(part) / 60**k for k, part in enumerate(gps[name])) for name in ("GPSLatitude", "GPSLongitude")
        )
        places.append((lon, lat, float(gps["GPSAltitude"])))
        assert all(name in copy for name in (b"GPSZAccuracy", b"Camera:Yaw", b"drone-dji:DewarpData"))
        tags = exif.get_ifd(ExifTags.IFD.Exif)  # 261 of a diagonal of 400 pixels, on 43.3 mm
        assert tags[ExifTags.Base.FocalLengthIn35mmFilm] == 28
    found = np.array([_enu(*place) for place in places])
    np.testing.assert_allclose(found, [camera.centre for camera in cameras()[:3]], atol=MILLIMETRE)
    assert not (out / "exif" / "air" / "p4.jpg").exists()


def test_what_is_no_jpeg_gets_a_sidecar(run: Path, out: Path) -> None:
    assert (out / "exif" / "air" / "p3.png").read_bytes() == (run.parent / "air" / "p3.png").read_bytes()
    text = (out / "exif" / "air" / "p3.xmp").read_text(encoding="utf-8")
    found = next(ET.fromstring(text).iter("{http://www.w3.org/1999/02/22-rdf-syntax-ns#}Description")).attrib
    degrees, minutes = found["{http://ns.adobe.com/exif/1.0/}GPSLatitude"].rstrip("S").split(",")
    over, under = found["{http://ns.adobe.com/exif/1.0/}GPSAltitude"].split("/")
    lon_degrees, lon_minutes = found["{http://ns.adobe.com/exif/1.0/}GPSLongitude"].rstrip("W").split(",")
    place = (-int(lon_degrees) - float(lon_minutes) / 60, -int(degrees) - float(minutes) / 60, int(over) / int(under))
    np.testing.assert_allclose(_enu(*place), cameras()[3].centre, atol=MILLIMETRE)


def test_below_the_ellipsoid_and_former_positions(run: Path) -> None:
    row = CameraRow("a.jpg", "airborne", 0, "REGISTERED", 0.25, 0.5, -12.5)
    original = (run.parent / "air" / "p0.jpg").read_bytes()
    once = photo_with_position(original, replace(row, height=80.0), "a.jpg")
    twice = photo_with_position(once, row, "a.jpg")
    gps = Image.open(io.BytesIO(twice)).getexif().get_ifd(ExifTags.IFD.GPSInfo)
    assert (gps[ExifTags.GPS.GPSAltitudeRef], float(gps[ExifTags.GPS.GPSAltitude])) == (b"\1", 12.5)
    assert twice.count(b"Exif\0\0") == 1
    assert twice.count(b"GPSAltitudeRef=") == 1
    assert 'GPSAltitudeRef="1"' in position_xmp(row)
    for broken in (b"", b"\xff\xd8", original[:300], b"GIF89a"):
        with pytest.raises(InputError, match=r"a\.jpg: its EXIF cannot be rewritten"):
            photo_with_position(broken, row, "a.jpg")


def test_odm_reads_positions_and_control(out: Path) -> None:
    head, *lines = (out / "odm" / "airborne" / "geo.txt").read_text().splitlines()
    assert head == "EPSG:4326"
    words = [line.split() for line in lines]
    assert [one[0] for one in words] == ["p0.jpg", "p1.jpg", "p2.jpg", "p3.png"]
    _assert_cameras([tuple(map(float, one[1:4])) for one in words])
    assert words[0][7:] == ["2.1000", "3.8000"]
    for one, camera in zip(words, cameras(), strict=False):
        # ODM's own words: north-east-down axes turned by yaw, pitch and roll; then the camera looks down.
        yaw_pitch_roll = Rotation.from_euler("ZYX", [float(word) for word in one[4:7]], degrees=True).as_matrix()
        north_east_down = yaw_pitch_roll @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # of right, down, forward
        enu = north_east_down[[1, 0, 2]] * [[1], [1], [-1]]
        np.testing.assert_allclose(enu, camera.cam_from_world.rotation.T, atol=1e-5)
    head, *lines = (out / "odm" / "airborne" / "gcp_list.txt").read_text().splitlines()
    assert head == "EPSG:4326"
    named = {camera.image.rpartition("/")[2]: camera for camera in cameras()}
    assert len({line.split()[6] for line in lines}) == 20
    for line in lines:
        lon, lat, height, u, v, image, _ = line.split()
        pose = named[image].cam_from_world
        xyz = pose.apply(_enu(float(lon), float(lat), float(height))[None])[0]
        brown = np.array(LENS.distortion)
        lens = np.array([[LENS.fx, 0, LENS.cx - 0.5], [0, LENS.fy, LENS.cy - 0.5], [0, 0, 1]])
        px, _ = cv2.projectPoints(xyz[None], np.zeros(3), np.zeros(3), lens, brown)
        np.testing.assert_allclose(px.ravel(), [float(u), float(v)], atol=0.05)
    with pytest.raises(InputError, match=r"x y\.jpg: ODM's lists part words by spaces"):
        odm_geo([CameraRow("x y.jpg", "airborne", 0, "REGISTERED", 1.0, 2.0, 3.0)])


def test_photos_of_one_name_in_two_folders_stay_apart_for_odm(run: Path, tmp_path: Path) -> None:
    both = tmp_path / "run"
    shutil.copytree(run, both)
    table = (both / "cameras.csv").read_text().splitlines()
    first = table[1].replace("air/p0.jpg", "ground/p0.jpg").replace(",airborne,", ",ground0,")
    (both / "cameras.csv").write_text("\n".join([*table, first]) + "\n")
    assert main(["export", str(both), "--to", "odm", "--out", str(tmp_path / "out"), "--quiet"]) == 0
    for name, count in (("airborne", 4), ("ground0", 1)):
        _, *lines = (tmp_path / "out/odm" / name / "geo.txt").read_text().splitlines()
        assert [line.split()[0] for line in lines][:1] == ["p0.jpg"] and len(lines) == count


def test_an_unknown_format_is_told(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(run), "--to", "nerfstudo", "--out", str(run.parent / "no")]) == 2
    assert "did you mean nerfstudio?" in capsys.readouterr().err
    assert chosen_formats(["kml,exif", "kml"]) == ["kml", "exif"]
    with pytest.raises(InputError, match="name a format"):
        chosen_formats([","])


def test_foreign_files_photos_and_the_run_are_left_alone(run: Path, tmp_path: Path) -> None:
    result = Result.read(run)
    for bad in (run.parent, run.parent / "air", run.parent / "air" / "in", run, run / "colmap"):
        with pytest.raises(InputError, match="give another folder with --out"):
            export(result, ["kml"], bad, lambda _: None)
    export(result, ["kml"], tmp_path, lambda _: None)
    export(result, ["kml"], tmp_path, lambda _: None)  # what it wrote itself may go
    (tmp_path / "kml" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"mine\.txt: was not written by skymoor export"):
        export(result, ["kml"], tmp_path, lambda _: None)
    assert (tmp_path / "kml" / "mine.txt").read_text() == "mine"


def test_all_leaves_out_formats_whose_library_is_missing(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(source: Source, folder: Path) -> str:
        raise BackendUnavailable('copclib cannot be imported: install it with pip install "skymoor[export]"')

    monkeypatch.setitem(FORMATS, "copc", missing)
    for name in set(FORMATS) - {"copc", "kml"}:
        monkeypatch.delitem(FORMATS, name)
    told: list[str] = []
    export(Result.read(run), ["all"], tmp_path, told.append)
    assert [line for line in told if "left out: copclib" in line and "skymoor[export]" in line]
    assert (tmp_path / "kml").is_dir() and not (tmp_path / "copc").exists()
    with pytest.raises(BackendUnavailable):
        export(Result.read(run), ["copc"], tmp_path, told.append)


def test_each_product_has_a_line_that_counts(run: Path, tmp_path: Path) -> None:
    told: list[str] = []
    export(Result.read(run), ["geojson"], tmp_path, told.append)
    assert told == [f"{tmp_path / 'geojson'}: 4 cameras, 1 without a position left out"]


def test_a_run_without_a_place_or_file_is_told(run: Path, tmp_path: Path) -> None:
    result = Result.read(run)
    lost = replace(result, folder=tmp_path)
    (tmp_path / "cameras.csv").write_text(
        "image,set,component,status,lat,lon,height,ce90,le90\na,airborne,0,NOT_REGISTERED,,,,,\n"
    )
    with pytest.raises(InputError, match="nothing is registered"):
        export(lost, ["kml"], tmp_path / "out", lambda _: None)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "cameras.csv").write_bytes((run / "cameras.csv").read_bytes())
    with pytest.raises(InputError, match=r"pointcloud\.laz: is missing from the run"):
        export(replace(result, folder=tmp_path / "b"), ["laz"], tmp_path / "out", lambda _: None)
    assert not (tmp_path / "out" / "laz").exists()


def test_a_height_that_is_not_confirmed_is_in_no_format_that_can_do_without(tmp_path: Path) -> None:
    row = CameraRow("a.jpg", "airborne", 0, "REGISTERED", 46.5, 7.25, None, 1.0, 2.0, 60.0, ce90=2.0)
    assert odm_geo([row]).splitlines()[1] == "a.jpg 7.2500000000 46.5000000000"
    assert "GPSAltitude=" not in position_xmp(row) and "GPSLatitude=" in position_xmp(row)
    assert ExifTags.GPS.GPSAltitude not in gps_tags(row) and ExifTags.GPS.GPSLatitude in gps_tags(row)
    write_geopackage(tmp_path / "cameras.gpkg", [row], [])
    _, _, points, _ = pyogrio.raw.read(tmp_path / "cameras.gpkg")
    assert struct.unpack("<dd", points[0][5:21]) == (7.25, 46.5)


def test_formats_that_need_heights_say_that_they_are_not_confirmed(run: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(run, tmp_path / "run")
    path = copy / "summary.json"
    summary = json.loads(path.read_text())
    for part in summary["sets"][0]["components"]:
        part["heights"] = "NOT_CONFIRMED"
    path.write_text(json.dumps(summary))
    told: list[str] = []
    export(Result.read(copy), ["colmap,geojson"], tmp_path / "out", told.append)
    said = {
        name: json.loads((tmp_path / "out" / name / "export.json").read_text())["heights"]
        for name in FORMATS
        if (tmp_path / "out" / name).exists()
    }
    assert said["colmap"].startswith("NOT_CONFIRMED") and said["geojson"].startswith("none")
    assert "NOT_CONFIRMED" in told[0]
    beside = next((tmp_path / "out/colmap").rglob("georeference.json"))
    assert json.loads(beside.read_text())["heights"] == "NOT_CONFIRMED"
