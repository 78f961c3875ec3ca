# SPDX-License-Identifier: Apache-2.0
"""What QGIS loads: it registers the provider, and takes it away again."""

from __future__ import annotations

from qgis.core import QgsApplication

from .provider import SkymoorProvider


class SkymoorPlugin:
    """Works without a window as well, so that `qgis_process` finds the algorithms."""

    def __init__(self, iface):
        self.iface = iface
        self.provider = None

    def initProcessing(self):  # noqa: N802
        self.provider = SkymoorProvider()
        QgsApplication.processingRegistry().addProvider(self.provider)

    def initGui(self):  # noqa: N802
        self.initProcessing()

    def unload(self):
        if self.provider is not None:
            QgsApplication.processingRegistry().removeProvider(self.provider)
            self.provider = None
