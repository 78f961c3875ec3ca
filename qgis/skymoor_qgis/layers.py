# SPDX-License-Identifier: Apache-2.0
"""The layers of a finished run, with their styles."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from qgis.core import QgsProcessingContext, QgsProcessingLayerPostProcessorInterface

STYLES = Path(__file__).parent / "styles"
HEIGHTS = "dsm"


@dataclass(frozen=True)
class Product:
    """A file of the run that is shown: the name of its layer, and of its style where it has one."""

    path: Path
    name: str
    style: str = ""


def products(out: Path) -> list[Product]:
    """Those that are there and show something, the lowest layer first."""
    placed = [
        Product(path, f"{out.name}: {path.name}", HEIGHTS if path.stem.endswith(HEIGHTS) else "")
        for path in sorted((out / "placed").glob("*.tif"), key=lambda path: not path.stem.endswith(HEIGHTS))
    ]
    own = [Product(out / "dsm.tif", f"{out.name}: DSM", HEIGHTS), Product(out / "ortho.tif", f"{out.name}: orthophoto")]
    found = [one for one in (placed or own) if one.path.is_file()]
    cameras = out / "cameras.geojson"
    if _has_positions(cameras):
        found.append(Product(cameras, f"{out.name}: cameras", "cameras"))
    return found


def load(found: Sequence[Product], context: QgsProcessingContext) -> None:
    """Have them added to the project when the algorithm has ended, each above those before it."""
    loaded: dict[int, str] = {}
    for rank, product in enumerate(found):
        details = QgsProcessingContext.LayerDetails(product.name, context.project(), product.name)
        with suppress(AttributeError):  # of QGIS 3.32 and later, which sort by it
            details.layerSortKey = rank
        details.setPostProcessor(_Shown.of(product, rank, loaded, context.project()))
        context.addLayerToLoadOnCompletion(str(product.path), details)


class _Shown(QgsProcessingLayerPostProcessorInterface):
    """Gives a layer its style when it has been loaded, and its place: QGIS loads layers in the order of their paths."""

    kept: list[_Shown] = []  # noqa: RUF012 - QGIS keeps no reference to them

    def __init__(self, product, rank, loaded, project):
        super().__init__()
        self.product, self.rank, self.loaded, self.project = product, rank, loaded, project

    @classmethod
    def of(cls, *about):
        cls.kept.append(cls(*about))
        return cls.kept[-1]

    def postProcessLayer(self, layer, context, feedback):  # noqa: N802
        if self.product.style:
            layer.loadNamedStyle(str(STYLES / f"{self.product.style}.qml"))
            layer.triggerRepaint()
        self.loaded[self.rank] = layer.id()
        root = self.project.layerTreeRoot()
        for rank in sorted(self.loaded):
            node = root.findLayer(self.loaded[rank])
            if node is not None:  # each goes to the top, the highest one last
                node.parent().insertChildNode(0, node.clone())
                node.parent().removeChildNode(node)


def _has_positions(cameras: Path) -> bool:
    try:
        features = json.loads(cameras.read_text(encoding="utf-8"))["features"]
    except (OSError, ValueError, KeyError):
        return False
    return any(one.get("geometry") for one in features)
