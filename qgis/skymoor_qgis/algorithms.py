# SPDX-License-Identifier: Apache-2.0
"""The algorithms: `skymoor run` and `skymoor register` on layers of the project."""

from __future__ import annotations

import shlex
from collections import deque
from pathlib import Path

from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import (
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingOutputBoolean,
    QgsProcessingOutputHtml,
    QgsProcessingParameterFile,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterString,
)

from . import command
from .layers import load, products

KEPT_LINES = 50
HELP = """The reference is an orthophoto of the project with its DSM, in any CRS. State the vertical datum of
its heights: "ellipsoid", or an EPSG code such as EPSG:3855; it is never guessed. CE90 and LE90 are the accuracy of the
reference in metres (90 percent); without them positions are accurate relative to the reference only. Started again with
the same output folder, it continues where it stopped. A place that is not certain is refused: the log says why."""


class _Register(QgsProcessingAlgorithm):
    """What both share: the reference, the output folder, and the run of the command."""

    ORTHO, DSM, DATUM, CE90, LE90, OUT = "ORTHO", "DSM", "VERTICAL_DATUM", "CE90", "LE90", "OUTPUT"
    REGISTERED, REPORT = "REGISTERED", "REPORT"

    def createInstance(self):  # noqa: N802
        return type(self)()

    def shortHelpString(self):  # noqa: N802
        return f"<p>{self.about}</p><p>{HELP}</p>"

    def initAlgorithm(self, config=None):  # noqa: N802
        for parameter in self.inputs():
            self.addParameter(parameter)
        metres = QgsProcessingParameterNumber.Double
        for parameter in (
            QgsProcessingParameterRasterLayer(self.ORTHO, "Reference: orthophoto"),
            QgsProcessingParameterRasterLayer(self.DSM, "Reference: surface model (DSM)", optional=True),
            QgsProcessingParameterString(self.DATUM, "Vertical datum of the DSM", "ellipsoid", optional=True),
            QgsProcessingParameterNumber(
                self.CE90, "CE90 of the reference, m", metres, None, optional=True, minValue=0.0
            ),
            QgsProcessingParameterNumber(
                self.LE90, "LE90 of the reference, m", metres, None, optional=True, minValue=0.0
            ),
            QgsProcessingParameterFolderDestination(self.OUT, "Folder for the result"),
        ):
            self.addParameter(parameter)
        self.addOutput(QgsProcessingOutputBoolean(self.REGISTERED, "Everything is registered"))
        self.addOutput(QgsProcessingOutputHtml(self.REPORT, "Report"))

    def processAlgorithm(self, parameters, context, feedback):  # noqa: N802
        out = Path(self.parameterAsString(parameters, self.OUT, context))
        try:
            program = command.found_command(ProcessingConfig.getSetting(command.COMMAND_SETTING) or "")
            words = command.arguments_of(program, **self._stated(parameters, context), out=str(out))
            feedback.pushCommandInfo(shlex.join(words))
            status, last = _followed(words, feedback)
            if status is None:
                feedback.pushInfo("Stopped; started again with the same folder, it continues from here.")
                return {}
            found = command.outcome(status, last, out)
        except command.CommandError as error:
            raise QgsProcessingException(str(error)) from None
        for line in found.lines:
            (feedback.pushInfo if ": registered," in line else feedback.pushWarning)(line)
        feedback.setProgress(100)
        load(products(out), context)
        report = out / "report.html"
        answer = {self.OUT: str(out), self.REGISTERED: found.registered}
        return {**answer, self.REPORT: str(report)} if report.is_file() else answer

    def _stated(self, parameters, context):
        """The arguments of `arguments_of` but the command and the folder."""

        def number(name):
            return None if parameters.get(name) is None else self.parameterAsDouble(parameters, name, context)

        dsm = _file(self.parameterAsRasterLayer(parameters, self.DSM, context))
        return {
            "ortho": _file(self.parameterAsRasterLayer(parameters, self.ORTHO, context)),
            "dsm": dsm,
            "vertical_datum": self.parameterAsString(parameters, self.DATUM, context) if dsm else "",
            "ce90": number(self.CE90),
            "le90": number(self.LE90),
            **self.data(lambda name: self.parameterAsFile(parameters, name, context)),
        }


class RegisterPhotos(_Register):
    """`skymoor run`."""

    AIRBORNE, GROUND = "AIRBORNE", "GROUND"
    about = "Finds where photos without GPS were taken, and places the model that is made of them on Earth."

    def name(self):
        return "registerphotos"

    def displayName(self):  # noqa: N802
        return "Register photos"

    def inputs(self):
        folder = QgsProcessingParameterFile.Folder
        yield QgsProcessingParameterFile(
            self.AIRBORNE, "Folder of airborne photos, with sub-folders", folder, optional=True
        )
        yield QgsProcessingParameterFile(self.GROUND, "Folder of ground photos", folder, optional=True)

    def data(self, file):
        return {"airborne": _given(file(self.AIRBORNE)), "ground": _given(file(self.GROUND))}


class RegisterModel(_Register):
    """`skymoor register`."""

    MODEL, MODEL_DSM = "MODEL", "MODEL_DSM"
    about = "Finds where an orthophoto, cloud, mesh or splat without a place belongs, and writes it there."

    def name(self):
        return "registermodel"

    def displayName(self):  # noqa: N802
        return "Register an orthophoto or model"

    def inputs(self):
        yield QgsProcessingParameterFile(self.MODEL, "Orthophoto, cloud, mesh or splat")
        yield QgsProcessingParameterFile(self.MODEL_DSM, "Surface model of that orthophoto", optional=True)

    def data(self, file):
        return {"model": _given(file(self.MODEL), file(self.MODEL_DSM))}


def _followed(words, feedback):
    """Exit status of the command, None where it was cancelled, and its last lines; shows progress."""
    last, stages = deque(maxlen=KEPT_LINES), 0

    def heard(line):
        nonlocal stages
        last.append(line)
        feedback.pushConsoleInfo(line)
        stage = command.ended_stage(line)
        if stage is not None:
            stages += 1
            feedback.setProgress(command.share_done(stages))
            feedback.setProgressText(f"{stage} done")

    return command.run(words, heard, feedback.isCanceled), list(last)


def _file(layer):
    """The file of a raster layer; empty without a layer."""
    if layer is None:
        return ""
    path = layer.source().split("|")[0]
    if layer.dataProvider().name() != "gdal" or not Path(path).is_file():
        raise command.CommandError(
            f"layer {layer.name()} is not a file; export the part that matters as GeoTIFF, and take that"
        )
    return path


def _given(*paths):
    return [path for path in paths if path]
