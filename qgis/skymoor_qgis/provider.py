# SPDX-License-Identifier: Apache-2.0
"""The provider: two algorithms, and one setting, the skymoor command."""

from __future__ import annotations

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsProcessingProvider

from .algorithms import RegisterModel, RegisterPhotos
from .command import COMMAND_SETTING, DEFAULT_COMMAND


class SkymoorProvider(QgsProcessingProvider):
    """Settings > Options > Processing > Providers > skymoor has the setting."""

    def id(self):
        return "skymoor"

    def name(self):
        return "skymoor"

    def load(self):
        ProcessingConfig.addSetting(
            Setting(self.name(), COMMAND_SETTING, "Path of the skymoor command", DEFAULT_COMMAND)
        )
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self):
        ProcessingConfig.removeSetting(COMMAND_SETTING)

    def loadAlgorithms(self):  # noqa: N802
        for algorithm in (RegisterPhotos, RegisterModel):
            self.addAlgorithm(algorithm())
