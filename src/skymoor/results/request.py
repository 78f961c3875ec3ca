# SPDX-License-Identifier: Apache-2.0
"""What a run was asked for, as it stands in summary.json, and the same site again from there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_ACCURACY
from skymoor.pipeline.job import ComponentResult
from skymoor.pipeline.option_parser import option_values
from skymoor.pipeline.options import Options
from skymoor.pipeline.prior import own_azimuth, plain_prior, prior_from_plain
from skymoor.pipeline.reference_files import ReferenceFiles
from skymoor.pipeline.site import Site
from skymoor.pipeline.site_control import control_from_plain, plain_control
from skymoor.results.read import Result
from skymoor.results.report.words import flattened
from skymoor.sources.addresses import Addressed, public_address
from skymoor.store import plain

ON_COMMAND_LINE = "command line"
GIVEN = "model"
"""The set of a model that was given, and not made of photos."""


def request_of(site: Site) -> dict[str, Any]:
    """What `site_of_run` needs beside the rest of the summary. An address with a key is not written down."""
    named = (None, None) if site.addressed is None else (site.addressed.ortho, site.addressed.dsm)
    ortho, dsm = (one if one is None or public_address(one) == one else "" for one in named)
    stated = site.reference.covariance
    return {
        "site_file": None if site.source == ON_COMMAND_LINE else Path(site.source).resolve(),
        "root": site.root.resolve(),
        "ortho_address": ortho,
        "dsm_address": dsm,
        "covariance_m2": None if np.isnan(stated).any() else stated,
        "reference_run": None if site.reference.run is None else site.reference.run.resolve(),
        "photos": None if site.photos is None else site.photos.resolve(),
        "prior": plain_prior(site.prior),
        "control": plain_control(site.control),
    }


def credits_of(site: Site) -> dict[str, str | None]:
    """Licence, credit and date of the reference, and its addresses without keys; None where nothing is stated."""
    files, sources = site.reference, site.addressed
    shown = (None, None) if sources is None else (sources.ortho, sources.dsm)
    ortho, dsm = (None if one is None else public_address(one) for one in shown)
    return {
        "licence": files.licence,
        "credit": files.credit,
        "date": files.date,
        "ortho_source": ortho,
        "dsm_source": dsm,
    }


def first_photo(item: ComponentResult) -> dict[str, Any] | None:
    """The first photo by its name, and where it looks on the render: what a direction on the render says of it."""
    first = min(item.component.cameras, key=lambda camera: camera.image, default=None)
    if first is None:
        return None
    return {"image": first.image, "azimuth_deg": float(np.degrees(own_azimuth(first)) % 360)}


def changed_options(result: Result) -> dict[str, object]:
    """The options of a run that are not the defaults, by their dotted names.

    Defaults are left out also because JSON has no word for some of them, such as infinite budgets.
    """
    defaults = dict(flattened(plain(option_values(Options()))))
    return {
        name: value
        for name, value in flattened(result.summary["options"])
        if name not in defaults or defaults[name] != value
    }


def site_of_run(result: Result) -> Site:
    """The site of a finished run as it was asked for, without what a person stated later; its options are all set.

    Of a given model the site's `airborne` are the model's files.

    Raises `InputError` where the summary does not say enough.
    """
    summary, file = result.summary, result.folder / "summary.json"
    again = "give the same skymoor command again with what you know as --area, --near, --heading or --height"
    request = summary.get("request")
    if request is None:
        raise InputError(f"{file}: was written by a version that did not record how it was asked for; {again}")
    names = [one["set"] for one in summary["sets"]]
    try:
        if "" in (request["ortho_address"], request["dsm_address"]):
            raise InputError(f"{file}: an address of the reference has a key, which is not kept; {again}")
        sources = {one["set"]: tuple(Path(part["path"]) for part in one["sources"]) for one in summary["sets"]}
        files, addressed = summary["reference"], request["ortho_address"]
        stated, dsm = request["covariance_m2"], files["dsm"]
        reference = ReferenceFiles(
            ortho=Path(files["ortho"]),
            dsm=Path(dsm) if isinstance(dsm, str) else dsm,
            vertical_datum=files["vertical_datum"],
            covariance=UNKNOWN_ACCURACY if stated is None else np.array(stated, dtype=np.float64),
            **{key: files[key] for key in ("licence", "credit", "date")},
            run=None if request.get("reference_run") is None else Path(request["reference_run"]),
        )
        return Site(
            name=summary["site"],
            root=Path(request["root"]),
            reference=reference,
            airborne=sources.get("airborne", sources.get(GIVEN, ())),
            ground=tuple(sources[name] for name in names if name.startswith("ground")),
            options=changed_options(result),
            source=str(request["site_file"] or ON_COMMAND_LINE),
            prior=prior_from_plain(request["prior"]),
            photos=None if request.get("photos") is None else Path(request["photos"]),
            control=control_from_plain(request.get("control")),
            addressed=None if addressed is None else Addressed(addressed, request["dsm_address"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{file}: is damaged or of another version ({error!r}); {again}") from error
