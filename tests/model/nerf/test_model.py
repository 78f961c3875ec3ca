# SPDX-License-Identifier: Apache-2.0
"""The trained field against the box on a plane: heights, colours, confidence, and how it is stored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model.nerf.toy import PIXEL, ROOF, TINY, Toy, blind_half, blinded, cast, component_of, down_view, heights, texture
from skymoor.errors import BackendUnavailable, DegenerateGeometry, InputError
from skymoor.model import NerfBuilder
from skymoor.model.nerf.model import NerfModel
from skymoor.model.nerf.uncertainty import reliability
from skymoor.pipeline.option_parser import with_options
from skymoor.store._cache import read_cache, write_cache
from skymoor.types import Render, View

VIEW = down_view()


def errors(toy: Toy, render: Render) -> np.ndarray:
    found = toy.error_px(render.xyz, VIEW)
    return np.asarray(found[np.isfinite(found)])


def test_exact_depths_give_exact_heights(toy: Toy, trained: NerfModel, prior_only: NerfModel) -> None:
    before, after = (errors(toy, model.render(VIEW)) for model in (prior_only, trained))
    assert len(after) > 0.9 * VIEW.shape[0] * VIEW.shape[1]
    assert 0.005 < np.median(np.abs(after)) < 0.12
    assert np.median(np.abs(after)) < 0.8 * np.median(np.abs(before)) < 0.2
    assert (np.abs(after) < 1).mean() > 0.99


def test_noisy_depths_with_holes_give_heights_below_their_noise(toy: Toy, rough: NerfModel) -> None:
    # The noise is 0.4 % of about 1.1, which is 0.37 pixels.
    found = errors(toy, rough.render(VIEW))
    assert 0.02 < np.median(np.abs(found)) < 0.22
    assert (np.abs(found) < 1).mean() > 0.98


def test_photos_find_a_roof_that_no_depth_map_measured(toy: Toy) -> None:
    maps, half = blinded(toy.exact), blind_half(VIEW)
    median = []
    for builder in (toy.untrained, toy.with_sizes(iterations=300)):
        render = builder(component_of(maps), maps).render(VIEW)
        error = np.abs(toy.error_px(render.xyz, VIEW)[half])
        median.append(np.median(error[np.isfinite(error)]))
        # Nobody can confirm it: it is shown, but not believed.
        assert render.confidence[half].max() < 0.05
    assert median[0] > 3
    assert median[1] < 1
    assert np.isfinite(error).mean() > 0.9


def test_every_ray_is_its_pixels_centre(trained: NerfModel) -> None:
    view = down_view(size=40)
    render = trained.render(view)
    u, v = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5)
    known = np.isfinite(render.xyz[..., 2])
    assert known.mean() > 0.8
    assert np.abs(render.xyz[..., 0] - (view.x0 + u * view.pixel))[known].max() < 1e-5
    assert np.abs(render.xyz[..., 1] + (view.y0 + v * view.pixel))[known].max() < 1e-5


def test_large_views_are_refined_from_coarse_ones(
    toy: Toy, trained: NerfModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = trained.render(VIEW)
    monkeypatch.setattr("skymoor.model.nerf.render.COARSEST_PX", 24)
    fine = trained.render(VIEW)
    gap = np.abs(fine.xyz[..., 2] - whole.xyz[..., 2]) / PIXEL
    assert 1e-4 < np.nanmedian(gap) < 0.05
    assert (gap[np.isfinite(gap)] < 1).mean() > 0.97
    assert np.median(np.abs(errors(toy, fine))) < 0.12


def test_an_oblique_view_hits_the_same_surface(trained: NerfModel) -> None:
    c, s = np.cos(0.6), np.sin(0.6)
    rotation = np.array([[1, 0, 0], [0, -c, -s], [0, s, -c]])
    view = View(rotation, -0.25, -0.2, PIXEL, (34, 42))
    render = trained.render(view)
    u, v = np.meshgrid(np.arange(42) + 0.5, np.arange(34) + 0.5)
    plane = np.stack([view.x0 + u * PIXEL, view.y0 + v * PIXEL, np.full(u.shape, -2.0)], axis=-1) @ rotation
    truth = np.array([o + cast(o, rotation[2][None]) * rotation[2] for o in plane.reshape(-1, 3)])
    gap = np.linalg.norm(render.xyz.reshape(-1, 3) - truth, axis=1) / PIXEL
    assert np.nanmedian(gap) < 0.25
    assert (gap < 1.5).mean() > 0.85
    on_ray = render.xyz.reshape(-1, 3) @ rotation.T
    assert np.nanmax(np.abs(on_ray[:, 0] - (view.x0 + u.ravel() * PIXEL))) < 1e-4


def test_colours_of_photos_and_of_the_field(toy: Toy, trained: NerfModel) -> None:
    u, v = np.meshgrid(np.arange(96) + 0.5, np.arange(96) + 0.5)
    x, y = VIEW.x0 + u * VIEW.pixel, -(VIEW.y0 + v * VIEW.pixel)
    truth = texture(np.stack([x, y, heights(x, y)], axis=-1).reshape(-1, 3)).reshape(96, 96, 3) * 255
    photos, field = trained.render(VIEW), replace(trained, texture="field").render(VIEW)
    known = np.isfinite(toy.error_px(photos.xyz, VIEW))
    for picture, limit in ((photos.rgb, 10), (field.rgb, 25)):
        assert 0.5 < np.median(np.abs(picture - truth)[known]) < limit
    assert not np.array_equal(photos.rgb, field.rgb)
    np.testing.assert_array_equal(field.rgb[known], trained.field_colours(VIEW)[known])
    np.testing.assert_array_equal(field.xyz, photos.xyz)


def test_confidence_means_accuracy(toy: Toy, rough: NerfModel) -> None:
    render = rough.render(VIEW)
    assert ((render.confidence >= 0) & (render.confidence <= 1)).all()
    error = np.abs(toy.error_px(render.xyz, VIEW))
    mean, share, counts = reliability(render.confidence, error.astype(np.float32), 0.3, bins=3)
    assert counts.min() > 100
    assert share[0] + 0.02 < share[1] < share[2]
    assert share[2] > 0.9
    assert (np.diff(mean) > 0.1).all()


def test_depth_maps_that_contradict_lower_the_confidence(trained: NerfModel) -> None:
    liars = tuple(
        replace(m, depth=(1.05 * m.depth).astype(np.float32)) if k % 2 else m for k, m in enumerate(trained.maps)
    )
    doubted = replace(trained, maps=liars).render(VIEW)
    assert np.median(doubted.confidence) < 0.6 * np.median(trained.render(VIEW).confidence)


def test_what_no_photo_sees_is_unknown(trained: NerfModel) -> None:
    far = replace(VIEW, x0=20.0)
    render = trained.render(far)
    assert np.isnan(render.xyz).all()
    assert not render.confidence.any()


def test_a_model_survives_the_cache(trained: NerfModel, tmp_path: Path) -> None:
    before = trained.render(down_view(size=40))
    write_cache(tmp_path / "model.npz", None, trained)
    again = read_cache(tmp_path / "model.npz")[1].render(down_view(size=40))
    np.testing.assert_array_equal(again.rgb, before.rgb)
    np.testing.assert_array_equal(again.confidence, before.confidence)


def test_what_a_view_must_cover(trained: NerfModel) -> None:
    assert trained.pixel == pytest.approx(PIXEL, rel=0.25)
    low, high = np.percentile(trained.surface_points, [1, 99], axis=0)
    assert (low[:2] < -0.25).all()
    assert (high[:2] > 0.25).all()
    assert high[2] == pytest.approx(ROOF[2], abs=0.01)


def test_exposures_of_photos_do_not_show(toy: Toy) -> None:
    factors = np.linspace(0.8, 1.25, len(toy.exact))
    maps = [
        replace(m, rgb=np.clip(m.rgb * f, 0, 255).astype(np.uint8)) for m, f in zip(toy.exact, factors, strict=True)
    ]
    model = toy.untrained(component_of(maps), maps)
    # Whatever the common exposure is, the photos agree afterwards.
    ratios = [
        np.median(new.rgb[20:50, 30:60]) / np.median(old.rgb[20:50, 30:60])
        for new, old in zip(model.maps, toy.exact, strict=True)
    ]
    assert np.std(ratios) < 0.03
    assert np.std(factors) > 0.1


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_depth_maps_are_refused(toy: Toy, count: int) -> None:
    with pytest.raises(DegenerateGeometry, match="two photos"):
        toy.builder(component_of(toy.exact), toy.exact[:count])


def test_depths_that_are_not_certain_are_refused(toy: Toy) -> None:
    unsure = [replace(m, sigma=np.full_like(m.depth, 1.0)) for m in toy.exact]
    with pytest.raises(DegenerateGeometry, match="certain"):
        toy.builder(component_of(unsure), unsure)


def test_cuda_that_is_missing_is_named(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(BackendUnavailable, match="CUDA"):
        replace(toy.builder, device="cuda")(component_of(toy.exact), toy.exact)


def test_options_by_their_names() -> None:
    builder = with_options(NerfBuilder(), {"preset": "huge", "iterations": 512, "budget_s": 60})
    assert builder.sizes.appearance == 32
    assert builder.colours == "field"
    assert (builder.sizes.iterations, builder.budget_s) == (512, 60.0)
    assert NerfBuilder().sizes == NerfBuilder().small
    with pytest.raises(InputError, match="no option losses"):
        with_options(NerfBuilder(), {"losses.ranking": 0.0})
    assert NerfBuilder().colours == "blend"
    with pytest.raises(ValueError, match="must not be negative"):
        replace(NerfBuilder().losses, depth=-1.0)
    with pytest.raises(ValueError, match="positive"):
        replace(TINY, samples=1)
