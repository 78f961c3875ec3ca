# SPDX-License-Identifier: Apache-2.0
"""A run's summary is enough to ask for the same again, and says when it is not."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_ACCURACY
from skymoor.pipeline.option_parser import option_values, with_options
from skymoor.pipeline.options import Options
from skymoor.pipeline.prior import Person, SearchPrior
from skymoor.pipeline.site import Site, load_site
from skymoor.results.read import Result
from skymoor.results.request import changed_options, request_of, site_of_run
from skymoor.sources.addresses import Addressed
from skymoor.store import plain
from support.tiny_site import content, make_site, run


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site whose run was refused, in its folder out."""
    site = make_site(tmp_path_factory.mktemp("site"))
    assert run(site, "--set", "match.max_height_m=150", "--heading", "0.png=30", "--seed", "4") == 3
    return site


def changed(ended: Path, tmp_path: Path, change: Callable[[dict[str, Any]], object]) -> Result:
    summary = json.loads((ended / "out/summary.json").read_text())
    change(summary)
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    return Result.read(tmp_path)


def test_the_same_site_comes_back(ended: Path) -> None:
    result, asked = Result.read(ended / "out"), load_site(ended / "site.toml")
    again = site_of_run(result)
    assert (again.root, again.sets, again.source) == (asked.root, asked.sets, str(ended / "site.toml"))
    assert again.reference.ortho == asked.reference.ortho and again.reference.dsm == asked.reference.dsm
    np.testing.assert_allclose(again.reference.covariance, asked.reference.covariance)
    assert again.reference.vertical_datum == "ellipsoid" and again.name == asked.name
    assert again.prior.heading is not None and again.prior.heading.image == "0.png" and again.prior.area is None
    assert again.options == {"match.max_height_m": 150.0}
    helped = replace(again, person=Person(SearchPrior.of(height=40.0)))
    assert helped.bounds.height_m == 40.0 and helped.bounds.heading == again.prior.heading
    assert request_of(helped) == request_of(again)  # what a person stated is no part of it


def test_every_option_survives_json() -> None:
    options = with_options(Options(), {"match.max_height_m": 150, "reconstruct.min_cameras": 4})
    written = json.loads(json.dumps(plain(option_values(options))))
    found = changed_options(replace(_nothing(), summary={"options": written}))
    assert found == {"match.max_height_m": 150.0, "reconstruct.min_cameras": 4}
    assert with_options(Options(), found) == options


def test_addresses_are_kept_without_keys(ended: Path, tmp_path: Path) -> None:
    site = load_site(ended / "site.toml")
    unknown = replace(site.reference, covariance=UNKNOWN_ACCURACY)
    addressed = replace(site, reference=unknown, addressed=Addressed("https://x.example/o.tif", None))
    kept = request_of(addressed)
    assert (kept["ortho_address"], kept["dsm_address"], kept["covariance_m2"]) == (
        "https://x.example/o.tif",
        None,
        None,
    )
    again = site_of_run(changed(ended, tmp_path, lambda one: one.update(request=plain(kept))))
    assert again.addressed == addressed.addressed and np.isnan(again.reference.covariance).all()
    secret = replace(site, addressed=Addressed("https://x.example/o.tif?key=SECRET", None))
    assert "SECRET" not in json.dumps(plain(request_of(secret)))
    with pytest.raises(InputError, match="has a key, which is not kept; give the same skymoor command again"):
        site_of_run(changed(ended, tmp_path, lambda one: one.update(request=plain(request_of(secret)))))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda one: one.pop("request"), "did not record how it was asked for"),
        (lambda one: one["request"].pop("root"), "damaged or of another version"),
        (lambda one: one["request"].update(prior=3), "damaged or of another version"),
        (lambda one: one["sets"][0].pop("sources"), "damaged or of another version"),
    ],
)
def test_what_is_not_enough_is_one_line(
    change: Callable[[dict[str, Any]], object], words: str, ended: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"summary\.json") as error:
        site_of_run(changed(ended, tmp_path, change))
    assert words in str(error.value) and "--near" in str(error.value) and "\n" not in str(error.value)


def test_a_run_without_components_has_nothing_to_ask(ended: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from skymoor.cli.main import main

    before = content(ended / "out")
    assert main(["ask", str(ended / "out"), "--height", "40"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "nothing was reconstructed" in line
    assert main(["ask", str(ended), "--height", "40"]) == 2
    assert "summary.json" in capsys.readouterr().err
    assert content(ended / "out") == before


def test_a_given_model_is_asked_for_again(ended: Path, tmp_path: Path) -> None:
    def model(one: dict[str, Any]) -> None:
        one["sets"] = [one["sets"][0] | {"set": "model"}]
        one["request"]["photos"] = str(tmp_path)

    site = site_of_run(changed(ended, tmp_path, model))
    assert site.airborne and not site.ground and site.photos == tmp_path


def _nothing() -> Result:
    from skymoor.geo import EnuFrame

    return Result(Path(), {}, EnuFrame(0.0, 0.0, 0.0), UNKNOWN_ACCURACY, ())


def test_it_is_a_site(ended: Path) -> None:
    assert isinstance(site_of_run(Result.read(ended / "out")), Site)
