"""Many scenes by one command: what becomes of each, and of the others when one fails."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from cli_support import QUICK, refused, run, run_json, snapshot, write_scene
from scoup.base.locks import locked_file
from scoup.cli import scene_runs
from support import HANGS, environments

pytestmark = pytest.mark.usefixtures("quick_python")

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "many_scenes.md"
RUN = "from scoup.cli.app import entry; entry()"
# In place of scoup for one scene, and much quicker: writes its arguments and surroundings into the output.
WRITES = """
import json, os, sys
(out,) = [text.removeprefix("--out=") for text in sys.argv if text.startswith("--out=")]
scene = out.removesuffix(".scoup")
print("at work")
"""
WRITES_OUT = """
with open(out, "w") as stream:
    json.dump({"arguments": sys.argv[1:], "environment": dict(os.environ), "folder": os.getcwd()}, stream)
"""
FAILS = """
if scene == "bad":
    print("error: no good", file=sys.stderr)
    sys.exit(int(os.environ["EXIT_CODE"]))
"""
FAILS_ONCE = """
if scene == "bad" and not os.path.exists("tried"):
    open("tried", "w").close()
    os.kill(os.getpid(), 9)
"""
# With the true start of a scene's process: it waits, and says by a file that it was terminated.
WAITS = """
import time
from scoup.cli import app
def wait():
    try:
        open("waiting", "w").close()
        while True:
            time.sleep(0.05)
    except app.Terminated:
        open("terminated", "w").close()
        sys.exit(143)
def entry():
    import signal
    signal.signal(signal.SIGTERM, app._terminate)
    wait()
if scene == "slow":
    app.entry = entry
    from scoup.cli.scene_runs import entry as begin
    begin()
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def quick(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for scoup in the processes of scenes, and a list of the scenes a, bad and b."""
    monkeypatch.setattr(scene_runs, "PROGRAM", WRITES + FAILS + WRITES_OUT)
    monkeypatch.setenv("EXIT_CODE", "1")
    listed("a", "bad", "b")


def listed(*names: str, **defaults: object) -> Path:
    """The list lists/scenes.yaml of scenes of these names; their fields are lists/NAME.scoup."""
    path = Path("lists/scenes.yaml")
    path.parent.mkdir(exist_ok=True)
    scenes = [{"name": name, "scene": name, "out": f"{name}.scoup"} for name in names]
    path.write_text(json.dumps({"defaults": defaults, "scenes": scenes}))
    return path


def many(*arguments: object) -> tuple[int, dict[str, tuple[str, int, str]]]:
    """Build the scenes of the list: exit code, and of each its result, attempts and message."""
    code, out, err = run("build", "--manifest", "lists/scenes.yaml", *arguments, "--json")
    record = json.loads(out)
    assert len(err.splitlines()) == code, err
    return code, results(record)


def results(record: dict[str, Any]) -> dict[str, tuple[str, int, str]]:
    return {
        row["name"]: (row["result"], row.get("attempts", 0), row.get("message", ""))
        for row in record["scenes"]
    }


MADE, THERE, NOT_RUN = ("made", 1, ""), ("there already", 0, ""), ("not run yet", 0, "")


def test_two_scenes_and_a_broken_one(here: Path) -> None:
    """Fields as by one command each; the broken scene is named, and made once it is mended."""
    for seed, name in enumerate(("one", "two")):
        write_scene(here / "data" / name, seed=seed)
    Path("data/list.yaml").write_text(
        "defaults: {n-atoms: 8, effort: fast, model: one/words.npz}\n"
        "scenes:\n"
        "  - {name: first, scene: one, build: {out: ../fields/first.scoup}}\n"
        "  - {name: broken, scene: three}\n"
        "  - {name: second, scene: two, seed: 1}\n"
    )
    code, out, err = run("build", "--manifest", "data/list.yaml", "--seed", "2")
    assert code == 1
    logs = here / "data" / "list.yaml.logs" / "build"
    assert err == (
        f"error: 1 of 3 scenes failed (broken); what they printed is in {logs}; the same command tries them again\n"
    )
    assert out.splitlines()[1].startswith("broken (2 of 3): failed in ")
    assert out.count("┃") > 0
    assert out.count("there is no such scene") == 2  # when it happens, and in the table
    assert json.loads((logs / "broken.json").read_text())["attempts"] == 1  # it would end alike again
    assert "150 Gaussians, 4 views with regions" in (logs / "second.log").read_text()
    os.chdir("data")
    for name, field, alike in (
        ("one", "../fields/first.scoup", "../fields/a.scoup"),
        ("two", "two.scoup", "a.scoup"),
    ):
        run_json("build", name, *QUICK, "--seed", "2", "--model", "one/words.npz", "--out", alike)
        assert Path(field).read_bytes() == Path(alike).read_bytes()
    Path("two").rename("three")
    code, out, err = run("build", "--manifest", "list.yaml", "--seed", "2", "--quiet")
    assert (code, out, err) == (0, "", "")
    assert Path("three.scoup").is_file()


def test_extract_builds_on_its_record(here: Path) -> None:
    """A folder that is there may be unfinished: what has made it says."""
    scene = write_scene(here / "scene")
    for path in (scene / "language_features").iterdir():
        path.unlink()
    Path("list.yaml").write_text(
        "defaults: {extract: {segmenter: felzenszwalb, embedder: colors}, build: {n-atoms: 8}}\n"
        "scenes: [{name: a, scene: scene}]\n"
    )
    call = ("extract", "--manifest", "list.yaml")
    assert results(run_json(*call)) == {"a": MADE}
    assert len(list((scene / "language_features").glob("*.regions"))) == 4
    assert results(run_json(*call)) == {"a": THERE}
    Path("list.yaml.logs/extract/a.json").unlink()
    assert results(run_json(*call)) == {"a": MADE}
    assert "0 views made, 4 already there" in Path("list.yaml.logs/extract/a.log").read_text()


@pytest.mark.usefixtures("quick")
def test_what_the_process_of_a_scene_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOCAL_RANK", "3")
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "x")
    monkeypatch.setenv("ROLE_OF_MINE", "y")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["src", "/else"]))
    listed("a", **{"n-atoms": 8, "k": 3, "embed-geometry": True, "keep": None, "device": "cuda"})
    code, found = many("--k=2", "--retries=0", "--rounds", "1", "--retries", "1", "--shard=1/1")
    assert (code, found) == (0, {"a": MADE})
    given = json.loads(Path("lists/a.scoup").read_text())
    assert given["folder"] == str(Path("lists").absolute())
    assert given["arguments"][0] == "build"
    assert sorted(given["arguments"][1:-1]) == sorted([
        str(Path("lists/a").absolute()), "--out=a.scoup", "--n-atoms=8", "--embed-geometry", "--k=2", "--rounds", "1",
        "--device=cuda",
    ])  # fmt: skip
    assert given["arguments"][-1] == "--device=cuda:3"
    assert given["environment"]["ROLE_OF_MINE"] == "y"
    assert given["environment"]["PYTHONPATH"] == os.pathsep.join([str(Path("src").absolute()), "/else"])
    assert not {"LOCAL_RANK", "TORCHELASTIC_RUN_ID"} & given["environment"].keys()


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(("code", "retries", "attempts"), [(1, 2, 3), (143, 1, 2), (1, 0, 1), (2, 5, 1)])
def test_what_fails_is_tried_again_unless_it_is_a_mistake(
    code: int, retries: int, attempts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXIT_CODE", str(code))
    assert many("--retries", retries) == (1, {"a": MADE, "bad": ("failed", attempts, "no good"), "b": MADE})
    log = Path("lists/scenes.yaml.logs/build/bad.log").read_text()
    assert log.count("attempt ") == log.count("error: no good") == log.count("at work") == attempts


@pytest.mark.usefixtures("quick")
def test_a_killed_process_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_runs, "PROGRAM", WRITES + FAILS_ONCE + WRITES_OUT)
    code, found = many("--retries", "0")
    assert (code, found["bad"]) == (1, ("failed", 1, "killed by SIGKILL; perhaps for lack of memory"))
    Path("lists/tried").unlink()
    assert many() == (0, {"a": THERE, "bad": ("made", 2, ""), "b": THERE})


@pytest.mark.usefixtures("quick")
def test_what_is_there_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    assert many()[0] == 1
    before = snapshot(Path())
    monkeypatch.setenv("EXIT_CODE", "0")
    monkeypatch.setattr(scene_runs, "PROGRAM", WRITES + WRITES_OUT)
    assert many() == (0, {"a": THERE, "bad": MADE, "b": THERE})
    assert {path: text for path, text in snapshot(Path()).items() if "bad" not in path} == {
        path: text for path, text in before.items() if "bad" not in path
    }
    other = ("there already", 0, "made with other options; --overwrite makes it anew")
    assert many("--seed", "3") == (0, dict.fromkeys(("a", "bad", "b"), other))
    assert many("--seed", "3", "--overwrite") == (0, dict.fromkeys(("a", "bad", "b"), MADE))
    assert "--seed" in json.loads(Path("lists/a.scoup").read_text())["arguments"]


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"name": "b"}', '{"name": "bad", "result": "made"}', "[" * 10**5]
)
def test_records_that_make_no_sense_are_none(text: str) -> None:
    record = Path("lists/scenes.yaml.logs/build/bad.json")
    record.parent.mkdir(parents=True)
    record.write_text(text)
    assert many("--shard", "1/2") == (0, {"a": MADE, "bad": NOT_RUN, "b": MADE})


@pytest.mark.usefixtures("quick")
def test_shards_are_all_scenes() -> None:
    assert many("--shard", "1/2") == (0, {"a": MADE, "bad": NOT_RUN, "b": MADE})
    failed = ("failed", 2, "no good")
    assert many("--shard", "2/2") == (1, {"a": MADE, "bad": failed, "b": MADE})
    # The first shard is done: what another has left is in the table, but not in its exit code.
    assert many("--shard", "1/2") == (0, {"a": THERE, "bad": failed, "b": THERE})


@pytest.mark.usefixtures("quick")
def test_a_scene_that_another_run_works_on_is_left_to_it() -> None:
    with locked_file(Path("lists/scenes.yaml.logs/build/a.json")):
        code, found = many()
    assert code == 1
    assert found["a"][0] == "failed"
    assert f"is being written by process {os.getpid()}" in found["a"][2]
    assert found["b"] == MADE


@pytest.mark.usefixtures("quick")
def test_what_is_refused() -> None:
    call = ("build", "--manifest", "lists/scenes.yaml")
    assert "SCENE do not go together" in refused(*call, "scene")
    assert "--retries must not be negative" in refused(*call, "--retries", "-1")
    assert "'3/2' is no shard" in refused(*call, "--shard", "3/2")
    assert "--retries goes with --manifest" in refused("build", "scene", "--retries", "2")
    assert "--shard goes with --manifest" in refused("extract", "scene", "--shard", "1/2")
    assert "there is no such file (a list of scenes was expected)" in refused("build", "--manifest", "x.yaml")
    path = listed("a", "b", out="c.scoup")
    path.write_text(path.read_text().replace('"a.scoup"', '"c.scoup"').replace('"b.scoup"', '"./c.scoup"'))
    assert "scenes 'a' and 'b' have one output" in refused(*call)
    for options, said in (
        ({"n-atoms": "many"}, "lists/scenes.yaml: scene 'a': Error parsing --n-atoms"),
        ({"preset": "x"}, "lists/scenes.yaml: scene 'a': invalid choice 'x' for argument '--preset'"),
        (
            {"embed-geometry": 1},
            "lists/scenes.yaml: scene 'a': embed-geometry is '1', expected true or false",
        ),
        ({"seed": True}, "lists/scenes.yaml: scene 'a': seed is 'True', expected a text or a number"),
        ({"overwrite": True}, "lists/scenes.yaml: defaults: scoup build has no option 'overwrite' here"),
    ):
        listed("a", **options)
        assert said in refused(*call)
    path.write_text('{"scenes": [{"name": "a"}]}')
    assert "scene 'a': has no scene; name its file or folder" in refused(*call)
    code, _, err = run("build")
    assert code == 2
    assert "Missing from scoup build" in err


def test_every_data_set_has_its_output(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_runs, "PROGRAM", "import sys; print(sys.argv)")
    Path("list.yaml").write_text(
        "scenes: [{name: a, root: x, scenes: [ramen, teatime], out: p}, {name: b, root: y, scenes: ramen}]"
    )
    for verb, folder in (
        ("lerf-ovs", "eval_lerf-ovs"),
        ("scannet", "eval_scannet"),
        ("baselines", "eval_lerf-ovs"),
    ):
        record = run_json("eval", verb, "--manifest", "list.yaml", "--retries", "0")
        assert results(record) == {"a": MADE, "b": MADE}
        logs = Path(f"list.yaml.logs/eval-{verb}")
        assert json.loads((logs / "b.json").read_text())["output"] == str(here / folder)
        assert "'--scenes=ramen', '--scenes=teatime'" in (logs / "a.log").read_text()


def test_the_list_of_the_document_serves_both_verbs(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    Path("scenes.yaml").write_text(text)
    monkeypatch.setattr(scene_runs, "PROGRAM", "import sys; print(sys.argv)")
    for verb, option in (("extract", "'--preset=fast'"), ("build", "'--out=fields/kitchen.scoup'")):
        assert results(run_json(verb, "--manifest", "scenes.yaml")) == {"kitchen": MADE, "hall": MADE}
        assert option in Path(f"scenes.yaml.logs/{verb}/kitchen.log").read_text()


def started(program: str, *arguments: str, before: str = "pass", **environment: str) -> subprocess.Popen[str]:
    """scoup in a process of its own, in which scenes are run by a stand-in."""
    code = f"from scoup.cli import scene_runs; scene_runs.PROGRAM = {program!r}; {before}; {RUN}"
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def appears(path: Path) -> bool:
    """Wait for a file."""
    end = time.monotonic() + HANGS
    while not path.exists() and time.monotonic() < end:
        time.sleep(0.05)
    return path.exists()


CALL = ("build", "--manifest", "lists/scenes.yaml")


@pytest.mark.parametrize(
    ("number", "word"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated"), (signal.SIGKILL, "")]
)
def test_the_process_of_a_scene_ends_with_the_run(here: Path, number: signal.Signals, word: str) -> None:
    listed("a", "slow", "b")
    with started(WRITES + WAITS + WRITES_OUT, *CALL) as process:
        assert appears(Path("lists/waiting"))
        process.send_signal(number)
        _, err = process.communicate(timeout=HANGS)
    if word:
        assert err == f"error: {word}; 1 of 3 scenes are done, run the same command again to continue\n"
    assert appears(Path("lists/terminated"))
    assert {path.name for path in Path("lists").glob("*.scoup")} == {"a.scoup"}
    with started(WRITES + WRITES_OUT, *CALL, "--json") as process:
        out, err = process.communicate(timeout=HANGS)
    assert results(json.loads(out)) == {"a": THERE, "slow": MADE, "b": MADE}


def together(
    program: str, ranks: Sequence[dict[str, str]], before: str = "pass"
) -> list[tuple[int, str, str]]:
    """The list in several processes: exit code, standard output, standard error of each."""
    processes = [started(program, *CALL, "--json", before=before, **rank) for rank in ranks]
    ended = [(process, process.communicate(timeout=HANGS)) for process in processes]
    return [(process.returncode, *streams) for process, streams in ended]


def test_torchrun_deals_scenes_out(here: Path) -> None:
    listed("a", "bad", "b", "c")
    with environments(2) as ranks:
        first, second = together(WRITES + FAILS + WRITES_OUT, [{**rank, "EXIT_CODE": "1"} for rank in ranks])
    assert (first[0], second) == (1, (0, "", "")), (first, second)
    failed = ("failed", 2, "no good")
    assert results(json.loads(first[1])) == {"a": MADE, "bad": failed, "b": MADE, "c": MADE}
    assert len(first[2].splitlines()) == 1
    given = json.loads(Path("lists/a.scoup").read_text())["environment"]
    assert not {"RANK", "WORLD_SIZE", "MASTER_PORT"} & given.keys()


def test_a_process_that_waits_for_the_scenes_of_others_can_be_interrupted(here: Path) -> None:
    listed("a", "slow")
    with environments(2) as ranks:
        first, second = [started(WRITES + WAITS + WRITES_OUT, *CALL, **rank) for rank in ranks]
        assert first.stdout is not None
        assert first.stdout.readline().startswith("a (1 of 1, process 1 of 2): made in ")
        assert appears(Path("lists/waiting"))
        time.sleep(0.5)  # so that it waits already; the outcome is to be the same before
        first.send_signal(signal.SIGINT)
        _, err = first.communicate(timeout=HANGS)
        assert second.poll() is None
        second.terminate()
        second.communicate(timeout=HANGS)
    assert (first.returncode, second.returncode) == (130, 143)
    assert err == "error: interrupted; 1 of 1 scenes are done, run the same command again to continue\n"
    assert appears(Path("lists/terminated"))


def test_a_process_that_is_lost_ends_the_others_with_one_message(here: Path) -> None:
    """The scenes of the others are made; the same command makes those that are left."""
    listed("a", "lost", "b")
    dies = "if scene == 'lost':\n    os.kill(int(os.environ['STARTER']), 9)\n    sys.exit(1)\n"
    with environments(2) as ranks:
        impatient = (
            "import os; os.environ['STARTER'] = str(os.getpid()); "
            "from scoup.base import processes; processes.SILENCE = 5.0"
        )
        first, second = together(WRITES + dies + WRITES_OUT, ranks, impatient)
    assert (first[0], second[0]) == (1, -9), (first, second)
    lines = first[2].splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: another of the processes at work together has ended")
    assert {path.name for path in Path("lists").glob("*.scoup")} == {"a.scoup", "b.scoup"}
    with environments(2) as ranks:
        first, second = together(WRITES + WRITES_OUT, ranks)
    assert (first[0], second[0]) == (0, 0), (first, second)
    assert results(json.loads(first[1])) == {"a": THERE, "lost": MADE, "b": THERE}
