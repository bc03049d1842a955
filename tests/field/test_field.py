"""The field and its file."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import save_file

import scoup
from messages import refuses
from scoup.base import FileFormatError, OutputExistsError
from scoup.field.field import GeometryMismatchError
from scoup.field.field_info import FieldInfo
from scoup.query import LanguageField, build
from scoup.scene import index_dtype
from scoup.uplift import BuildSettings, FieldSources
from support import random_gaussians, small_scene, unit
from uplift.edits import joined

QUICK = BuildSettings(n_atoms=8, k=3, keep=3, rounds=1, solver="adam", epochs=20)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def field(scene) -> LanguageField:
    return build(*scene, settings=QUICK, sources=FieldSources("a/model"))


def test_unpainted_gaussians_have_empty_codes_and_render_as_nothing(scene):
    gaussians, cameras, regions = scene
    hidden = random_gaussians(5, 1, ("behind",))
    hidden.means[:, 2] -= 50
    field = build(joined(gaussians, hidden), cameras, regions, settings=QUICK)
    assert not field.coded()[-5:].any()
    relevancy = field.gaussian_relevancy(unit(torch.randn(2, 16)), unit(torch.randn(3, 16)))
    assert (relevancy[:, :, -5:] == 0.5).all()
    assert field.render_codes(cameras[0]).shape == (3, 30, 40, 8)


@pytest.mark.parametrize("n_atoms", [8, 300])
def test_relevancy_equals_decoding_to_d_dimensions(scene, tmp_path, n_atoms):
    gaussians, cameras, regions = scene
    field = build(gaussians, cameras, regions, settings=BuildSettings(n_atoms=n_atoms, rounds=1))
    assert field.code_indices.dtype == index_dtype(n_atoms)
    field.save(tmp_path / "f.scoup")
    back = LanguageField.load(tmp_path / "f.scoup", gaussians)
    queries, canonical = unit(torch.randn(3, 16)), unit(torch.randn(4, 16))
    actual = back.relevancy(cameras[0], queries, canonical)
    own = back.gaussian_relevancy(queries, canonical)
    for s, level in enumerate(back.levels):
        rendered, decoded = back.render_features(cameras[0], level), back.gaussian_features(level)
        for found, features in ((actual[s].permute(1, 2, 0), rendered), (own[s].T, decoded)):
            best = (features @ canonical.T).amax(-1, keepdim=True)
            assert torch.allclose(found, torch.sigmoid(10 * (features @ queries.T - best)), atol=1e-4)


def test_eight_bits_are_close_and_take_no_code_away(field, tmp_path):
    even = torch.full((len(field), len(field.levels), 4), 1 / 600)
    indices = torch.zeros(even.shape, dtype=torch.uint16)
    many = LanguageField(indices, even, field.codebook.repeat(1, 75, 1), field.info)
    for name, each in (("f", field), ("many", many)):
        each.save(tmp_path / f"{name}.scoup", weight_bits=8)
        back = LanguageField.load(tmp_path / f"{name}.scoup")
        assert (back.code_weights.float() - each.code_weights.float()).abs().max() <= 1.5 / 255
        assert back.coded_levels().equal(each.coded_levels())
    with refuses():
        field.save(tmp_path / "g.scoup", weight_bits=4)


@pytest.fixture
def beside(field, tmp_path) -> LanguageField:
    """A field whose splat is in a file of its own."""
    splat = tmp_path / "scene" / "splat.ply"
    scoup.save_gaussians(field.gaussians, splat)
    made = field.with_gaussians(scoup.load_gaussians(splat))
    made.geometry_path = splat
    return made


def test_geometry_is_found_by_relative_path_and_checked(beside, tmp_path):
    beside.save(tmp_path / "scene" / "f.scoup")
    path = (tmp_path / "scene").rename(tmp_path / "moved") / "f.scoup"
    assert len(LanguageField.load(path).gaussians) == len(beside)
    with refuses(GeometryMismatchError):
        LanguageField.load(path, random_gaussians(len(beside), 77))
    path.with_name("splat.ply").unlink()
    with refuses(FileFormatError):
        _ = LanguageField.load(path).gaussians
    assert LanguageField.load(path, beside.gaussians).gaussians is beside.gaussians


def test_links_to_a_field_lead_to_what_it_names(beside, tmp_path):
    field, splat = beside, beside.geometry_path
    (tmp_path / "store" / "deep").mkdir(parents=True)
    (tmp_path / "linked").symlink_to(tmp_path / "store" / "deep")
    for folder in ("store/deep", "linked"):
        path = tmp_path / folder / "f.scoup"
        field.save(path, overwrite=True)
        link = tmp_path / "link.scoup"
        link.unlink(missing_ok=True)
        link.symlink_to(path)
        for name in (tmp_path / "linked" / "f.scoup", tmp_path / "store" / "deep" / "f.scoup", link):
            assert LanguageField.load(name).geometry_path == splat, (folder, name)
    field.geometry_path = tmp_path / "linked" / "splat.ply"  # beside the field, so it moves with it
    field.save(tmp_path / "linked" / "g.scoup")
    (tmp_path / "store").rename(tmp_path / "moved")
    moved = tmp_path / "moved" / "deep"
    assert LanguageField.load(moved / "g.scoup").geometry_path == moved / "splat.ply"


def test_nothing_is_overwritten_unless_wanted(field, tmp_path):
    path = tmp_path / "f.scoup"
    path.write_bytes(b"precious")
    with refuses(OutputExistsError):
        field.save(path)
    assert path.read_bytes() == b"precious"
    field.save(path, overwrite=True)
    assert len(LanguageField.load(path)) == len(field)


def test_parts_that_do_not_fit_are_refused(field):
    info, (indices, weights, codebook) = field.info, field.parts()[:3]
    for parts in (
        (indices[:, :2], weights, codebook, info),
        (indices, weights[..., :1], codebook, info),
        (indices, weights, codebook[:2], info),
        (indices, weights, codebook.bfloat16(), info),
        (indices.clone().fill_(8), weights, codebook, info),
        (indices, -weights, codebook, info),
        (indices, weights, codebook * torch.nan, info),
        (indices, weights, codebook, FieldInfo(info.levels, "", info.fingerprint, 3)),
    ):
        with refuses():
            LanguageField(*parts)


def test_other_files_are_named_for_what_they_are(tmp_path):
    with refuses(FileFormatError):
        LanguageField.load(tmp_path / "x.scoup")
    save_file({"a": torch.zeros(3)}, tmp_path / "x.scoup")
    with refuses(FileFormatError):
        LanguageField.load(tmp_path / "x.scoup")
