# SPDX-License-Identifier: Apache-2.0
"""The log of a run: steps, warnings and tracebacks, for later diagnosis."""

from __future__ import annotations

import logging
import platform
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from skymoor import __version__
from skymoor.errors import SkymoorError

LOG = logging.getLogger("skymoor")
FORMAT = "%(asctime)s %(levelname)s %(message)s"


class _File(logging.FileHandler):
    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """A full disk is reported where results are written; an incomplete log is no reason to stop."""


@contextmanager
def logged(path: Path, arguments: Sequence[str] | None = None) -> Iterator[None]:
    """Append to `path` what is logged in this block, and how it ends; a traceback if by an error."""
    handler = _File(path, encoding="utf-8", errors="backslashreplace")
    handler.setFormatter(logging.Formatter(FORMAT))
    level, passes = LOG.level, LOG.propagate
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    LOG.propagate = False  # the screen has its own messages
    command = " ".join(sys.argv if arguments is None else arguments)
    LOG.info("skymoor %s, Python %s on %s: %s", __version__, platform.python_version(), platform.platform(), command)
    try:
        yield
        LOG.info("done")
    except KeyboardInterrupt:
        LOG.warning("stopped by the user")
        raise
    except SkymoorError as error:
        LOG.error("%s", error)  # says all there is to say
        raise
    except Exception:
        LOG.exception("ended by an error")
        raise
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)
        LOG.propagate = passes
        handler.close()
