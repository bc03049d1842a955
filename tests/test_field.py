"""Uplift, build, the field and its file."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import scoup
from scoup import raster
from scoup.artefact import accumulators_path
from scoup.cameras import Cameras
from scoup.codes import SparseCodes
from scoup.coding.encode import encode
from scoup.errors import (
    FileFormatError,
    GeometryMismatchError,
    InputError,
    OutputExistsError,
    ScoupError,
    ScoupWarning,
)
from scoup.field import FieldInfo, LanguageField
from scoup.pipeline import BuildSettings, build
from scoup.regions import Regions
from scoup.uplifting import region_sums, top_k, uplift
from support import make_camera, random_gaussians, small_scene, unit

QUICK = BuildSettings(n_atoms=8, k=3, keep=3, rounds=1, solver="adam", epochs=20)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def field(scene) -> LanguageField:
    return build(*scene, settings=QUICK, embedding_model="a/model", keep_accumulators=True)


def test_uplift_from_kept_sums_equals_streaming(scene, field):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras, regions)
    codes = [
        scoup.fit_codes(regions.embeddings(level)[0], 8, 3, solver="adam", epochs=20).codes
        for level in regions.levels
    ]
    torch.testing.assert_close(uplift(sums, codes), field.accumulators, rtol=1e-5, atol=1e-6)
    indices, weights = top_k(field.accumulators, 3)
    assert torch.equal(indices, field.code_indices)
    assert torch.equal(weights.half(), field.code_weights)


def test_region_sum_matrix_times_codes_is_the_accumulator(scene, field):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras, regions)
    codes = scoup.fit_codes(regions.embeddings("m")[0], 8, 3, solver="adam", epochs=20).codes
    expected = torch.from_numpy(sums.matrix(1) @ codes.to_dense().numpy())
    assert torch.allclose(field.accumulators[:, 1], expected, rtol=1e-4, atol=1e-5)


def test_order_of_views_does_not_matter_beyond_rounding(scene):
    gaussians, cameras, regions = scene
    codes = [SparseCodes.from_dense(torch.rand(24, 8), 3) for _ in range(3)]
    forward = region_sums(gaussians, cameras, regions)
    backward = region_sums(gaussians, cameras.select(reversed(cameras.names)), regions)
    assert torch.allclose(uplift(forward, codes), uplift(backward, codes), rtol=1e-4, atol=1e-5)


def test_unpainted_gaussians_have_empty_codes_and_render_as_nothing(scene):
    gaussians, cameras, regions = scene
    hidden = random_gaussians(5, 1, ("behind",))
    hidden.means[:, 2] -= 50
    both = scoup.Gaussians(
        *(
            torch.cat([getattr(gaussians, n), getattr(hidden, n)])
            for n in ("means", "quats", "scales", "opacities", "sh")
        )
    )
    field = build(both, cameras, regions, settings=QUICK)
    assert not field.coded()[-5:].any()
    relevancy = field.gaussian_relevancy(unit(torch.randn(2, 16)), unit(torch.randn(3, 16)))
    assert (relevancy[:, :, -5:] == 0.5).all()
    assert field.render_codes(cameras[0]).shape == (3, 30, 40, 8)


def test_relevancy_equals_decoding_to_d_dimensions(scene, field):
    camera = scene[1][0]
    queries, canonical = unit(torch.randn(3, 16)), unit(torch.randn(4, 16))
    actual = field.relevancy(camera, queries, canonical)
    for s, level in enumerate(field.levels):
        features = field.render_features(camera, level)
        cosine = features @ queries.T
        against = (features @ canonical.T).amax(-1, keepdim=True)
        expected = torch.sigmoid(10 * (cosine - against)).permute(2, 0, 1)
        assert torch.allclose(actual[s], expected, atol=1e-4)


def test_gaussian_relevancy_equals_decoding(field):
    queries, canonical = unit(torch.randn(3, 16)), unit(torch.randn(4, 16))
    actual = field.gaussian_relevancy(queries, canonical)
    for s in range(3):
        codes = SparseCodes(field.code_indices[:, s], field.code_weights[:, s].float(), 8)
        features = unit(codes.to_dense() @ field.codebook[s])
        best = (features @ canonical.T).amax(1, keepdim=True)
        assert torch.allclose(actual[s].T, torch.sigmoid(10 * (features @ queries.T - best)), atol=1e-4)


def test_same_inputs_same_bytes(scene, tmp_path):
    for name in ("a", "b"):
        build(*scene, settings=QUICK).save(tmp_path / f"{name}.scoup")
    assert (tmp_path / "a.scoup").read_bytes() == (tmp_path / "b.scoup").read_bytes()


def test_file_round_trip(scene, field, tmp_path):
    path = tmp_path / "f.scoup"
    field.save(path, embed_geometry=True)
    back = LanguageField.load(path)
    for name in ("code_indices", "code_weights", "codebook", "accumulators"):
        assert torch.equal(getattr(back, name), getattr(field, name))
    assert back.info == field.info
    assert back.cameras is not None
    assert back.cameras.names == scene[1].names
    assert torch.equal(back.cameras[1].viewmat, scene[1][1].viewmat)
    assert back.gaussians.fingerprint() == scene[0].fingerprint()
    camera, queries = scene[1][0], unit(torch.randn(1, 16))
    assert torch.equal(back.relevancy(camera, queries, queries), field.relevancy(camera, queries, queries))


def test_eight_bit_weights_are_close(field, tmp_path):
    field.save(tmp_path / "f.scoup", weight_bits=8)
    back = LanguageField.load(tmp_path / "f.scoup")
    assert (back.code_weights.float() - field.code_weights.float()).abs().max() <= 1.5 / 255
    with pytest.raises(InputError, match="8 or 16"):
        field.save(tmp_path / "g.scoup", weight_bits=4)


def test_geometry_is_found_by_relative_path_and_checked(scene, tmp_path):
    gaussians, cameras, regions = scene
    (tmp_path / "scene").mkdir()
    splat = tmp_path / "scene" / "splat.ply"
    scoup.save_gaussians(gaussians, splat)
    stored = scoup.load_gaussians(splat)
    build(stored, cameras, regions, settings=QUICK, geometry_path=splat).save(tmp_path / "scene" / "f.scoup")
    (tmp_path / "scene").rename(tmp_path / "moved")
    path = tmp_path / "moved" / "f.scoup"
    assert len(LanguageField.load(path).gaussians) == len(gaussians)
    with pytest.raises(GeometryMismatchError, match="not the geometry"):
        LanguageField.load(path, random_gaussians(len(gaussians), 77))
    (tmp_path / "moved" / "splat.ply").unlink()
    with pytest.raises(FileFormatError, match=r"splat\.ply"):
        _ = LanguageField.load(path).gaussians
    assert LanguageField.load(path, stored).gaussians is stored


def test_nothing_is_overwritten_unasked(field, tmp_path):
    path = tmp_path / "f.scoup"
    path.write_bytes(b"precious")
    with pytest.raises(OutputExistsError, match="overwrite"):
        field.save(path)
    assert path.read_bytes() == b"precious"
    assert not accumulators_path(path).exists()
    field.save(path, overwrite=True)
    assert len(LanguageField.load(path)) == len(field)


def test_accumulators_of_an_earlier_field_are_not_taken(scene, field, tmp_path):
    path = tmp_path / "f.scoup"
    field.save(path)
    assert LanguageField.load(path).accumulators is not None
    build(*scene, settings=QUICK).save(path, overwrite=True)
    assert accumulators_path(path).exists()
    assert LanguageField.load(path).accumulators is None
    other = BuildSettings(n_atoms=8, k=2, keep=2, epochs=20, rounds=1, solver="adam")
    stale = accumulators_path(path).read_bytes()
    build(*scene, settings=other, keep_accumulators=True).save(path, overwrite=True)
    accumulators_path(path).write_bytes(stale)
    with pytest.raises(FileFormatError, match="does not belong"):
        _ = LanguageField.load(path).accumulators


def test_adding_a_view_equals_building_with_it(scene, field, tmp_path):
    """With the codes the codebook gives to the new regions, the vote is that of all views together."""
    gaussians, cameras, regions = scene
    fewer = build(gaussians, cameras[:3], regions, settings=QUICK, keep_accumulators=True)
    fewer.save(tmp_path / "f.scoup", embed_geometry=True)
    grown = LanguageField.load(tmp_path / "f.scoup").update(cameras[3], regions)
    assert grown.info.provenance["added_views"] == [cameras[3].name]
    only = region_sums(gaussians, cameras[3:], regions.select(cameras.names[3:]))
    codes = [
        encode(regions.load_embeddings(cameras.names[3], level), fewer.codebook[s], 3)
        for s, level in enumerate(regions.levels)
    ]
    assert torch.allclose(grown.accumulators, fewer.accumulators + uplift(only, codes), rtol=1e-5, atol=1e-6)
    with pytest.raises(InputError, match="votes once"):
        grown.update(cameras[3], regions)
    with pytest.raises(InputError, match="keep-accumulators"):
        build(gaussians, cameras[:3], regions, settings=QUICK).update(cameras[3], regions)


def test_added_regions_get_codes_of_k_atoms_whatever_a_gaussian_keeps(scene):
    gaussians, cameras, regions = scene
    everything = BuildSettings(n_atoms=8, k=2, keep=0, epochs=20, rounds=1, solver="adam")
    field = build(gaussians, cameras[:3], regions, settings=everything, keep_accumulators=True)
    grown = field.update(cameras[3], regions)
    before, after = field.accumulators, grown.accumulators
    assert before is not None
    assert after is not None
    # A Gaussian that one region paints alone gains exactly that region's two atoms.
    gained = ((after - before) > 0).sum(2)
    painted = gained > 0
    assert int(gained[painted].min()) <= 2


def test_an_interrupted_save_leaves_field_and_accumulators_together(scene, field, tmp_path, monkeypatch):
    from scoup import artefact

    path = tmp_path / "f.scoup"
    field.save(path)
    before = path.read_bytes(), accumulators_path(path).read_bytes()
    write = artefact._write

    def full_disk(target, *rest):
        if target == path:
            raise InputError("disk full")
        write(target, *rest)

    other = build(
        *scene,
        settings=BuildSettings(n_atoms=8, k=2, epochs=20, rounds=1, solver="adam"),
        keep_accumulators=True,
    )
    monkeypatch.setattr(artefact, "_write", full_disk)
    with pytest.raises(InputError, match="disk full"):
        other.save(path, overwrite=True)
    assert (path.read_bytes(), accumulators_path(path).read_bytes()) == before
    assert {item.name for item in tmp_path.iterdir()} == {"f.scoup", "f.scoup.accumulators"}


def test_eight_bits_take_no_code_away(scene, tmp_path):
    wide = BuildSettings(n_atoms=600, k=4, keep=0, epochs=2, rounds=1, solver="adam")
    field = build(*scene, settings=wide)
    assert field.code_indices.dtype == torch.uint16
    even = LanguageField(
        field.code_indices, torch.full_like(field.code_weights, 1 / 600), field.codebook, field.info, scene[0]
    )
    even.save(tmp_path / "f.scoup", weight_bits=8)
    assert LanguageField.load(tmp_path / "f.scoup").coded().all()


def test_more_than_256_atoms_from_build_to_answers(scene, tmp_path):
    gaussians, cameras, regions = scene
    field = build(gaussians, cameras, regions, settings=BuildSettings(n_atoms=300, rounds=1))
    field.save(tmp_path / "f.scoup")
    back = LanguageField.load(tmp_path / "f.scoup", gaussians)
    queries = unit(torch.randn(2, 16))
    features = back.render_features(cameras[0], "m")
    expected = (features @ queries.T).permute(2, 0, 1)
    best = expected.amax(0, keepdim=True)
    actual = back.relevancy(cameras[0], queries, queries)[1]
    assert torch.allclose(actual, torch.sigmoid(10 * (expected - best)), atol=1e-4)


def interrupt_build(scene, checkpoint: Path, views: int) -> None:
    """Build until so many views are lifted, then Ctrl-C."""

    def stop(stage, done, total):
        if stage == "uplift" and done == views:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build(*scene, settings=QUICK, checkpoint=checkpoint, progress=stop)


def test_an_interrupted_build_goes_on_and_gives_the_same_bytes(scene, tmp_path):
    build(*scene, settings=QUICK).save(tmp_path / "whole.scoup")
    checkpoint = tmp_path / "f.partial"
    interrupt_build(scene, checkpoint, views=2)
    assert checkpoint.exists()
    seen: list[tuple[str, int]] = []
    again = build(*scene, settings=QUICK, checkpoint=checkpoint, progress=lambda *a: seen.append(a[:2]))
    assert seen[0] == ("uplift", 2)  # neither coded nor lifted again
    again.save(tmp_path / "resumed.scoup")
    assert (tmp_path / "resumed.scoup").read_bytes() == (tmp_path / "whole.scoup").read_bytes()


def test_building_from_kept_sums_gives_the_same_bytes(scene, tmp_path):
    gaussians, cameras, regions = scene
    sums = region_sums(gaussians, cameras, regions)
    build(*scene, settings=QUICK).save(tmp_path / "streamed.scoup")
    build(*scene, settings=QUICK, sums=sums).save(tmp_path / "kept.scoup")
    assert (tmp_path / "streamed.scoup").read_bytes() == (tmp_path / "kept.scoup").read_bytes()
    with pytest.raises(InputError, match="lack 2 of the views"):
        build(*scene, settings=QUICK, sums=region_sums(gaussians, cameras[:2], regions))


def test_label_maps_changed_during_an_interruption(scene, tmp_path):
    gaussians, cameras, regions = scene
    checkpoint = tmp_path / "f.partial"
    interrupt_build(scene, checkpoint, views=2)
    flipped = Regions.from_maps(
        {
            name: {
                level: scoup.RegionMap(
                    regions.load(name, level).labels.flip(1), regions.load(name, level).embeddings
                )
                for level in regions.levels
            }
            for name in regions.view_names
        }
    )
    with pytest.warns(ScoupWarning, match="label maps of 'view_00.png' have changed"):
        resumed = build(gaussians, cameras, flipped, settings=QUICK, checkpoint=checkpoint)
    fresh = build(gaussians, cameras, flipped, settings=QUICK)
    assert torch.equal(resumed.code_weights, fresh.code_weights)
    assert (
        resumed.info.provenance["label_maps"] != build(*scene, settings=QUICK).info.provenance["label_maps"]
    )


def test_a_checkpoint_of_other_inputs_is_not_used(scene, tmp_path):
    checkpoint = tmp_path / "f.partial"
    gaussians, cameras, regions = scene
    interrupt_build(scene, checkpoint, views=1)
    seen: list[str] = []
    other = BuildSettings(n_atoms=8, k=2, keep=2, epochs=20, rounds=1, solver="adam")
    build(
        gaussians,
        cameras,
        regions,
        settings=other,
        checkpoint=checkpoint,
        progress=lambda *a: seen.append(a[0]),
    )
    assert seen[0] == "coding s"
    checkpoint.write_bytes(b"damaged")
    with pytest.warns(ScoupWarning, match="starting over"):
        build(*scene, settings=QUICK, checkpoint=checkpoint)


def test_cameras_that_see_nothing(scene):
    gaussians, cameras, regions = scene
    away = scoup.Gaussians(
        gaussians.means - 100, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh
    )
    with pytest.raises(InputError, match="see nothing"):
        build(away, cameras, regions, settings=QUICK)


def test_almost_nothing_seen_is_told(scene):
    _, cameras, regions = scene
    many = random_gaussians(400, 3)
    many.means[1:] -= 100
    many.means[0] = torch.tensor([0.0, 0.0, 3.0])
    many.opacities[0] = 0.9
    with pytest.warns(ScoupWarning, match="same frame"):
        build(many, cameras, regions, settings=QUICK)


def test_cameras_and_regions_of_different_scenes(scene):
    gaussians, _, regions = scene
    with pytest.raises(InputError, match="names agree"):
        build(gaussians, Cameras([make_camera(name="other.png")]), regions, settings=QUICK)


def test_embeddings_that_cannot_be_coded_are_refused(scene):
    gaussians, cameras, _ = scene
    labels = torch.zeros(30, 40, dtype=torch.int32)

    def regions_of(**embeddings: torch.Tensor) -> Regions:
        maps = {level: scoup.RegionMap(labels, rows) for level, rows in embeddings.items()}
        return Regions.from_maps({camera.name: maps for camera in cameras})

    with pytest.raises(InputError, match="zero embeddings"):
        build(gaussians, cameras, regions_of(m=torch.zeros(1, 16)), settings=QUICK)
    with pytest.raises(InputError, match="different sizes"):
        build(gaussians, cameras, regions_of(s=torch.ones(1, 16), m=torch.ones(1, 8)), settings=QUICK)


def test_a_level_without_regions_is_refused(scene):
    gaussians, cameras, _ = scene
    empty = scoup.RegionMap(torch.full((30, 40), -1, dtype=torch.int32), torch.zeros(0, 16))
    regions = Regions.from_maps({camera.name: {"m": empty} for camera in cameras})
    with pytest.raises(InputError, match="no regions"):
        build(gaussians, cameras, regions, settings=QUICK)


def test_wrong_queries_are_refused(scene, field):
    with pytest.raises(InputError, match="16 dimensions"):
        field.relevancy(scene[1][0], torch.randn(1, 17), torch.randn(1, 17))
    with pytest.raises(InputError, match="no level 'x'"):
        field.render_features(scene[1][0], "x")


def test_parts_that_do_not_fit_are_refused(field):
    info = field.info
    good = (field.code_indices, field.code_weights, field.codebook)
    for bad, message in [
        ((good[0][:, :2], good[1], good[2]), "must both be"),
        ((good[0], good[1], good[2][:2]), "does not fit"),
        ((good[0].clone().fill_(8), good[1], good[2]), "beyond the 8 atoms"),
        ((good[0], -good[1], good[2]), "negative"),
        ((good[0], good[1], good[2] * torch.nan), "finite"),
    ]:
        with pytest.raises(InputError, match=message):
            LanguageField(*bad, info)
    with pytest.raises(InputError, match="must both be"):
        LanguageField(*good, FieldInfo(info.levels, "", info.fingerprint, 3))


@pytest.fixture(scope="module")
def field_bytes(field, tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("field") / "f.scoup"
    field.save(path, embed_geometry=True)
    return path.read_bytes()


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_damaged_files_never_crash(field_bytes, tmp_path, data):
    damaged = bytearray(field_bytes)
    if data.draw(st.booleans()):
        del damaged[data.draw(st.integers(0, len(damaged))) :]
    header = min(len(damaged), 8 + struct.unpack("<Q", field_bytes[:8])[0])
    for _ in range(data.draw(st.integers(0, 6))):
        if damaged:
            limit = header if data.draw(st.booleans()) else len(damaged)
            damaged[data.draw(st.integers(0, max(0, limit - 1)))] = data.draw(st.integers(0, 255))
    path: Path = tmp_path / "damaged.scoup"
    path.write_bytes(damaged)
    message = "damaged.scoup"
    try:
        LanguageField.load(path)
    except ScoupError as error:
        message = str(error)
    assert "damaged.scoup" in message


def test_other_files_are_named_for_what_they_are(tmp_path):
    from safetensors.torch import save_file

    path = tmp_path / "x.scoup"
    with pytest.raises(FileFormatError, match="no such file"):
        LanguageField.load(path)
    save_file({"a": torch.zeros(3)}, path)
    with pytest.raises(FileFormatError, match="not a SCOUP language field"):
        LanguageField.load(path)
    metadata = {"scoup": json.dumps({"schema": "scoup.language_field", "version": 99})}
    save_file({"a": torch.zeros(3)}, path, metadata)
    with pytest.raises(FileFormatError, match="newer"):
        LanguageField.load(path)


def test_importing_scoup_is_light():
    """`import scoup` loads neither torch nor model code."""
    import subprocess
    import sys

    heavy = ("torch", "numpy", "transformers", "PIL", "scipy")
    code = f"import sys, scoup; print([name for name in {heavy} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_every_public_name_loads():
    for name in scoup.__all__:
        assert getattr(scoup, name) is not None
    assert callable(scoup.build)
    assert raster.BACKENDS
    with pytest.raises(AttributeError, match="no attribute"):
        _ = scoup.nonsense
