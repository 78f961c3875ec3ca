# SPDX-License-Identifier: Apache-2.0
"""One run of an algorithm in QGIS without a window, by the Python of QGIS: a job as JSON on stdin, what came of it out.

It is run as a program, and imports nothing of skymoor.
"""

from __future__ import annotations

import json
import os
import sys
import time

from processing.core.Processing import Processing
from processing.core.ProcessingConfig import ProcessingConfig
from processing.gui.Postprocessing import handleAlgorithmResults
from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProject,
    QgsRasterLayer,
)
from qgis.PyQt.QtCore import QSize


class Feedback(QgsProcessingFeedback):
    """Keeps what is said, and cancels after a while."""

    def __init__(self, cancel_after_s):
        super().__init__(False)
        self.said = {"info": [], "warning": [], "console": [], "progress": []}
        self.start, self.after_s = time.monotonic(), cancel_after_s

    def pushInfo(self, info):  # noqa: N802
        self.said["info"].append(info)

    def pushWarning(self, warning):  # noqa: N802
        self.said["warning"].append(warning)

    def pushConsoleInfo(self, info):  # noqa: N802
        self.said["console"].append(info)

    def setProgress(self, progress):  # noqa: N802
        self.said["progress"].append(progress)

    def isCanceled(self):  # noqa: N802
        return self.after_s is not None and time.monotonic() - self.start > self.after_s


def described(layer):
    """A layer of the project, as JSON."""
    found = {"name": layer.name(), "source": layer.source(), "valid": layer.isValid(), "crs": layer.crs().authid()}
    if hasattr(layer, "renderer") and hasattr(layer, "labeling"):
        symbols = layer.renderer().categories() if layer.renderer().type() == "categorizedSymbol" else []
        found["categories"] = [one.value() for one in symbols]
        found["circle"] = symbols[0].symbol().symbolLayer(0).properties() if symbols else {}
        properties = symbols[0].symbol().symbolLayer(0).dataDefinedProperties() if symbols else None
        found["size"] = (
            [properties.property(key).expressionString() for key in properties.propertyKeys()] if properties else []
        )
        found["label"] = layer.labeling().settings().fieldName if layer.labelsEnabled() else ""
        found["features"] = layer.featureCount()
    else:
        found["renderer"] = layer.renderer().type()
    return found


def rendered(path, crs, layers):
    """Draw layers, the first on top, into a PNG."""
    settings = QgsMapSettings()
    settings.setLayers(layers)
    settings.setDestinationCrs(QgsCoordinateReferenceSystem(crs))
    settings.setTransformContext(QgsProject.instance().transformContext())
    settings.setOutputSize(QSize(1400, 1000))
    extent = settings.layerExtentToOutputExtent(layers[0], layers[0].extent())
    extent.scale(1.3)
    settings.setExtent(extent)
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    job.renderedImage().save(path)


def main():
    job = json.load(sys.stdin)
    application = QgsApplication([], False)
    application.initQgis()
    Processing.initialize()
    from skymoor_qgis import classFactory

    plugin = classFactory(None)
    plugin.initProcessing()
    registry = QgsApplication.processingRegistry()
    ProcessingConfig.setSettingValue("SKYMOOR_COMMAND", job["command"])
    algorithm = registry.algorithmById(job["algorithm"])
    context, feedback = QgsProcessingContext(), Feedback(job.get("cancel_after_s"))
    context.setProject(QgsProject.instance())
    context.setFeedback(feedback)
    answer = {"algorithms": [one.id() for one in plugin.provider.algorithms()], "error": "", "results": None}
    start = time.monotonic()
    try:
        results, fine = algorithm.create().run(job["parameters"], context, feedback, {}, False)
        answer |= {"results": results, "fine": fine}
        handleAlgorithmResults(algorithm, context, feedback)
    except QgsProcessingException as error:
        answer["error"] = str(error)
    layers = list(QgsProject.instance().mapLayers().values())
    answer |= {"seconds": time.monotonic() - start, "said": feedback.said, "layers": [described(one) for one in layers]}
    shown = [one.layer() for one in QgsProject.instance().layerTreeRoot().findLayers()]
    answer["order"] = [one.name() for one in shown]
    if job.get("picture"):
        rendered(job["picture"], job["crs"], [*shown, *(QgsRasterLayer(path) for path in job.get("below", ()))])
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()
    plugin.unload()
    os._exit(0)  # QGIS may crash when it ends without having been shown


if __name__ == "__main__":
    main()
