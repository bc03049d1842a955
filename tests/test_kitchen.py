"""The real path on real geometry, small: convert, build, ask, score."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest

import scoup
from children import finished
from cli_support import run
from scoup.io import load_image
from scoup.raster import render_colors
from scoup_lab.data.labels import match_frames, read_labels
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.scores import SceneScore


@pytest.fixture
def kitchen(data_folder: Path) -> Path:
    folder = data_folder / "kitchen"
    if not folder.is_dir():
        pytest.skip(f"no kitchen in {data_folder}")
    return folder


@pytest.mark.data
@pytest.mark.slow
def test_kitchen_from_files_to_scores(kitchen: Path, data_folder: Path, tmp_path: Path):
    features = tmp_path / "features"
    script = [sys.executable, kitchen / "make_langsplat_features.py", kitchen, "--out", features]
    finished(script, check=True)
    # Eight of the 24 views hold less than the full build: every other labelled one, and views between.
    for path in features.glob("frame_*.npy"):
        if int(path.name[6:11]) not in (2, 4, 7, 9, 13, 15, 19, 22):
            path.unlink()
    splat, out = kitchen / "scene" / "model.splat", tmp_path / "kitchen.scoup"
    code, printed, err = run("build", kitchen, "--gaussians", splat, "--features", features, "--out", out)
    assert code == 0, err
    assert "16 of 24" in err  # cameras without features are counted
    assert "8 views" in printed
    field = scoup.LanguageField.load(out)
    frames = match_frames(read_labels(kitchen / "label"), scoup.load_cameras(kitchen, downscale=4))
    encoder = scoup.TextEncoder.open(data_folder / "clip" / "text_vit_b16_laion2b.npz")
    answers = [
        (frame, field.relevancy(camera, encoder.encode(list(frame.labels)), encoder.canonical()))
        for frame, camera in frames[:3]
    ]
    pairs = [pair for frame, maps in answers for pair in PROTOCOL.score_frame(frame, maps)]
    score = SceneScore("kitchen", PROTOCOL.rule().name, tuple(pairs), PROTOCOL.title)
    # The dense reference with all views and full size has 0.77 and 0.93; chance is near 0.05.
    assert score.miou > 0.5
    assert score.accuracy > 0.7


@pytest.mark.data
def test_a_render_is_the_scenes_own_image(kitchen: Path):
    """The kitchen's images were rendered from its splat by another rasteriser, then saved as JPEG."""
    camera = scoup.load_cameras(kitchen)["frame_00006"]
    rendered = render_colors(scoup.load_gaussians(kitchen / "scene" / "model.splat"), camera)
    error = (rendered - load_image(camera).float() / 255).square().mean()
    assert -10 * math.log10(float(error)) > 42  # dB; what JPEG leaves
