# SPDX-License-Identifier: Apache-2.0
"""Reading rasters over a network by GDAL's virtual file systems, and saying in one line why it does not work."""

from __future__ import annotations

import os
import re
import urllib.error
import urllib.request
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from skymoor.errors import InputError
from skymoor.sources.addresses import failed_tile, public_address, reads_network, web_address

TIMEOUT_S = 30
RETRIES = 3
CACHE_BYTES = 256 * 2**20  # as rasterio takes a number; GDAL would take a small one for megabytes
# Either says who asks: then requests are signed, else public buckets are read without.
_AWS_KEYS = (
    *("AWS_NO_SIGN_REQUEST", "AWS_ACCESS_KEY_ID", "AWS_PROFILE", "AWS_ROLE_ARN", "AWS_WEB_IDENTITY_TOKEN_FILE"),
    *("AWS_CONTAINER_CREDENTIALS_RELATIVE_URI", "AWS_CONTAINER_CREDENTIALS_FULL_URI"),
)
_TIMEOUT = re.compile(r"timed? ?out|timeout", re.IGNORECASE)
_HINDERED = re.compile(rf"{_TIMEOUT.pattern}|connect|resolve|certificate", re.IGNORECASE)
REMEDY_OF_STATUS = {
    401: "it asks for credentials; see docs/references.md on how to give them",
    403: "access is denied; check its licence and the credentials (docs/references.md)",
    404: "there is nothing at this address; check it",
    410: "there is nothing at this address any more; check it",
    429: "the server refuses so many requests; try again later",
}


def settings() -> dict[str, Any]:
    """GDAL's settings for the reads of this package; what the user has set in the environment stays."""
    chosen: dict[str, Any] = {
        # Folders are not listed, but masks and overviews beside a file are looked for by their names.
        "GDAL_DISABLE_READDIR_ON_OPEN": "TRUE",
        "GDAL_HTTP_TIMEOUT": TIMEOUT_S,
        "GDAL_HTTP_CONNECTTIMEOUT": TIMEOUT_S,
        "GDAL_HTTP_MAX_RETRY": RETRIES,
        "GDAL_HTTP_RETRY_DELAY": 1,
        "GDAL_CACHEMAX": CACHE_BYTES,
        "GTIFF_REPORT_COMPD_CS": True,
        # A server may have replaced a file since it was read last.
        "CPL_VSIL_CURL_NON_CACHED": "/vsicurl/:/vsis3/:/vsigs/",
    }
    home = Path(os.environ.get("AWS_SHARED_CREDENTIALS_FILE", "~/.aws/credentials")).expanduser()
    if not any(name in os.environ for name in _AWS_KEYS) and not home.exists():
        chosen["AWS_NO_SIGN_REQUEST"] = "YES"
    return {name: value for name, value in chosen.items() if name not in os.environ}


@contextmanager
def opened_source(name: str, shown: str, overview_level: int | None = None) -> Iterator[DatasetReader]:
    """Open a raster by its name for GDAL; errors, also of reads within the block, are `InputError` that say `shown`."""
    options = {} if overview_level is None else {"overview_level": overview_level}
    with rasterio.Env(**settings()), reported(name, shown), warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(name, **options) as source:
            yield source


@contextmanager
def tile_folder(folder: Path) -> Iterator[None]:
    """Keep tiles of services in a folder within the block; GDAL would keep them where the user works, for good."""
    with rasterio.Env(GDAL_DEFAULT_WMS_CACHE_PATH=str(folder)):
        yield


@contextmanager
def reported(name: str, shown: str) -> Iterator[None]:
    """Turn GDAL's errors into an `InputError` with the address and the remedy."""
    try:
        yield
    except RasterioError as error:
        text = str(error.__cause__ or error).splitlines()[0]
        if not reads_network(name):
            raise InputError(f"{shown}: cannot be read as a raster, is it complete? ({text.rstrip('.')})") from None
        raise InputError(f"{shown}: {reason_of(text, name)}") from None


def reason_of(text: str, name: str) -> str:
    """Why a read over the network failed, and the remedy: in the words of GDAL or, where it has none, of the server."""
    text = _without_addresses(text)
    status = re.search(r"(?:response code|HTTP error code|HTTP status|error)\D{0,12}(\d{3})\b", text)
    code = int(status[1]) if status else None
    if code is None and not _HINDERED.search(text):
        # Of most that GDAL cannot open only the server says whether it is there at all.
        web = failed_tile(name, text) or web_address(name)
        code, told = (None, "") if web is None else asked(web)
        text = told or text
    text = re.sub(r"^.*IReadBlock failed at [^:]*: ", "", text).rstrip(".")
    if code is not None and code >= 400:
        return reason_of_status(code)
    if _TIMEOUT.search(text):
        return f"no answer within {TIMEOUT_S} s; try again, or check the address"
    if _HINDERED.search(text):
        return f"cannot be reached ({text}); check the address and the network"
    return f"cannot be read as a raster, or broke off ({text}); try again, and check the file at its source"


def reason_of_status(code: int) -> str:
    """In words, with the remedy."""
    return f"HTTP status {code}: {REMEDY_OF_STATUS.get(code, 'the server failed; try again later')}"


def asked(address: str) -> tuple[int | None, str]:
    """The HTTP status of an address, asked for one byte; or None and what was in the way."""
    request = urllib.request.Request(address, headers={"Range": "bytes=0-0"})
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
            return int(answer.status), ""
    except urllib.error.HTTPError as error:
        error.close()
        return error.code, ""
    except TimeoutError:
        return None, "timed out"
    except (OSError, ValueError) as error:
        return None, _without_addresses(f"connection failed: {getattr(error, 'reason', None) or error}")


def _without_addresses(text: str) -> str:
    """Messages repeat addresses and names of files, whose queries may hold keys."""
    return re.sub(r"[^\s'\"<>,]*[/?][^\s'\"<>,]*", lambda found: public_address(found[0]), text)
