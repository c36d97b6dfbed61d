"""What can be known of a job is checked before the first capture, world by world, by every command."""

import json
import socket
from pathlib import Path

import pytest
import yaml

import mock_server
from omniscv.cli import run

GRID = {"grid": {"low": [-1, -1, 1.2], "high": [1, 1, 1.2], "step": 1}}
FREE = {"random": {"count": 3, "low": [-1, -1, 1], "high": [1, 1, 2], "clearance": 0.3}}
OUTSIDE = {"random": FREE["random"] | {"low": [50, 50, 50], "high": [51, 51, 51]}}
WORLDS = {"kitchen": {"source": "scene://four-wall"}, "shop": {"source": "scene://six-wall"}}
JOB = {
    "worlds": WORLDS,
    "poses": GRID,
    "cameras": {"panorama": {"model": "equirectangular", "width": 32, "height": 16}},
    "modes": ["lit", "object_mask", "depth"],
    "strategy": "cube",
    "face_size": 16,
    "out": "images",
}
ONE = {"worlds": None, "source": "scene://four-wall", "poses": [{"position": [0, 0, 1.5]}]}


@pytest.fixture
def omniscv(tmp_path, monkeypatch, capsys):
    """Runs a command on a job; returns the exit code, and the lines of both outputs."""
    monkeypatch.chdir(tmp_path)

    def command(words, **keys):
        job = {key: value for key, value in (JOB | keys).items() if value is not None}
        (tmp_path / "job.yaml").write_text(yaml.safe_dump(job), encoding="utf-8")
        code = run([*words.split(), "job.yaml"])
        output = capsys.readouterr()
        return code, output.out.splitlines(), output.err.splitlines()

    return command


def refusal(omniscv, commands, **keys):
    """The one line with which every command refuses a job, before it writes anything."""
    lines = set()
    for command in commands.split(", "):
        code, out, err = omniscv(command, **keys)
        assert (code in (1, 2), out, len(err)) == (True, [], 1), (command, code, out, err)
        lines.add(err[0].replace("omniscv: job.yaml: ", "omniscv: "))
    (line,) = lines
    return line


def with_shop(**keys):
    return {**WORLDS, "shop": WORLDS["shop"] | keys}


def test_each_command_refuses_a_later_world_before_the_first_capture(omniscv, tmp_path):
    for keys, says in (
        ({"source": "scene://seven-wall"}, "source: 'scene://seven-wall': scene: expected one of"),
        ({"source": "nowhere.sqlite"}, "nowhere.sqlite"),
        ({"source": "launch:game.sh"}, "source: expected the file of a game, got none at"),
        ({"times": [1, 2, 3]}, "times: expected one for each of 9 poses, got 3"),
        ({"poses": FREE, "times": [1, 2]}, "times: expected one for each of 3 poses, got 2"),
        ({"poses": {"grid": GRID["grid"] | {"clearance": 0.01}}, "times": [1, 2]}, "each of 9 poses, got 2"),
        ({"motions": {"Vase": [{"position": [0, 0, 1]}]}, "times": [0] * 9}, "of the scene, got 'Vase'"),
        ({"vary": {"objects": {"Layout_*": {"turn_deg": 3}}}}, "vary.objects.Layout_*: expected objects"),
        ({"poses": OUTSIDE}, "poses: expected a start, or the middle of the box, where something is seen"),
    ):
        line = refusal(omniscv, "plan, dataset make", worlds=with_shop(**keys))
        assert line.startswith("omniscv: worlds.shop: ")
        assert says in line
        assert [path.name for path in tmp_path.iterdir()] == ["job.yaml"]


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"sky": ["Sofa"]}, "worlds.shop: sky: expected objects of the scene, got 'Sofa'; it has"),
        ({"sky": ["Wal"], "modes": ["lit", "object_mask"]}, "worlds.kitchen: sky: expected objects of"),
        (
            {"sky": ["Layout_Ceiling"], "modes": ["lit", "depth"]},
            "worlds.kitchen: sky: expected object_mask in modes",
        ),
        (
            {"accuracy": "1%", "most_captures": 1, "strategy": "auto", "face_size": "auto"},
            "worlds.kitchen: most_captures: expected at least 18, which the first captures",
        ),
        (
            {"accuracy": "1%", "most_megapixels": 0.01, "strategy": "auto", "face_size": "auto"},
            "worlds.kitchen: most_megapixels: expected at least",
        ),
        pytest.param(
            {"color_rays": 4, "strategy": "cube", "modes": ["lit"]},
            "worlds.kitchen: color_rays: expected auto, 0, or strategy 'auto' or 'exact'",
            marks=pytest.mark.rays,
        ),
        (
            {"color_rays": 4, "record": "room.sqlite"},
            "worlds.kitchen: color_rays: expected auto or 0 beside record",
        ),
    ],
    ids=[
        "sky of another world",
        "sky misspelt",
        "sky without masks",
        "captures",
        "megapixels",
        "rays of cubes",
        "rays recorded",
    ],
)
def test_options_of_images_are_checked_by_world(keys, says, omniscv, tmp_path):
    worlds = {"kitchen": WORLDS["kitchen"], "shop": {"source": "scene://open"}}
    line = refusal(omniscv, "job, plan, dataset make", worlds=worlds, **keys)
    assert line.startswith(f"omniscv: {says}")
    assert [path.name for path in tmp_path.iterdir()] == ["job.yaml"]


def test_every_command_refuses_what_one_world_lacks(omniscv, tmp_path):
    moved = {"motions": {"Vaze": [{"time": 0, "position": [0, 0, 1]}]}, "times": [0]}
    line = refusal(omniscv, "job, plan, render, dataset make", **ONE, **moved)
    assert line.startswith("omniscv: motions: expected objects of the scene, got 'Vaze'; did you mean Vase?")
    assert not (tmp_path / "images").exists()


def test_files_are_looked_at_first(omniscv):
    one = ONE | {"modes": ["lit"]}
    assert omniscv("record", **one, record="room.sqlite")[0] == 0
    Path("other.txt").write_text("x", encoding="utf-8")
    poses = [{"position": [0, 0, 1.5]}, {"position": [0.4, 0, 1.5]}]
    for keys, says in (
        ({"out": "other.txt"}, "out: expected a folder or a free name, got a file: other.txt"),
        ({"record": "out", "out": "out"}, "record: expected a file such as room.sqlite, got a folder"),
        ({"strategy": "cube", "accuracy": 0.01}, "accuracy: expected none, or strategy 'auto'"),
        ({"record": "other.txt"}, "other.txt: expected a recording, got a file that is not a database"),
        ({"source": "room.sqlite"}, "the nearest recorded view differs in position by 0.4 m"),
    ):
        assert says in refusal(omniscv, "job, plan", **one | {"poses": poses} | keys)


def test_what_a_render_prints(omniscv):
    """What it took, older images, and that positions in centimetres see nothing."""
    code, out, _ = omniscv("render", **ONE, strategy=None, face_size=None, accuracy=0.01)
    assert code == 0
    assert out[-1].startswith("1 image: ")
    assert " % of the pixels in doubt (1 % asked)" in out[-1]
    _, _, err = omniscv("render", **ONE | {"poses": [{"position": [x, 0, 1.5]} for x in (0, 1)]})
    assert err == ["omniscv: images: 1 older images, which this job did not write, are beside the new ones"]
    code, _, err = omniscv("render", **ONE | {"poses": [{"position": [0, 0, 150]}], "out": "far"})
    assert (code, err[0]) == (0, "omniscv: panorama: 100 % of the rays meet nothing; positions are metres")


def test_a_server_that_nobody_runs_is_refused_by_its_world(omniscv):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    worlds = with_shop(source=f"unreal://127.0.0.1:{port}")
    worlds["shop"]["source_options"] = {"patience_s": 0.1}
    line = refusal(omniscv, "job, dataset make", worlds=worlds)
    assert line.startswith(f"omniscv: worlds.shop: No UnrealCV server reachable at 127.0.0.1:{port}")


def test_draws_without_a_chance_are_found_first_and_patterns_skip_what_cannot_move(omniscv, tmp_path):
    rule = {"shift": {"box": [[0, 0, 0], [1, 1, 0]]}, "clearance": 30}
    far = {"objects": {"Ball": rule, "Sofa": rule}}
    line = refusal(omniscv, "job, dataset make", worlds={"shop": WORLDS["shop"]}, vary=far)
    where = "shop-panorama-0, at shop/-1.000,-1.000,1.200: vary.objects.Sofa"
    assert line == f"omniscv: {where}: expected a free place, got none in 50 draws; give a smaller clearance"
    assert not (tmp_path / "images").exists()
    turned = {"objects": {"*": {"turn_deg": [0, 90]}}}
    with mock_server.serve("four-wall") as server:
        skipped = len(mock_server.load_scene("four-wall").static)
        says = f"vary.objects.*: skips {skipped} objects that the source cannot set so, such as static ones"
        for source in ("scene://four-wall", server.uri):
            code, _, err = omniscv("dataset make --overwrite", **ONE | {"source": source}, vary=turned)
            assert (code, [line for line in err if "skips" in line]) == (0, [f"omniscv: {says}"])


def test_many_worlds_are_listed_and_summed(omniscv):
    code, out, err = omniscv("job")
    assert (code, err) == (0, [])
    rows = [f"job.yaml: worlds.{name}: 1 camera at 9 poses, of {WORLDS[name]['source']}" for name in WORLDS]
    assert out[:3] == [*rows, "job.yaml: 18 images of 2 worlds"]
    code, out, _ = omniscv("plan --json")
    captures = {row["world"]: row["requests"] for row in json.loads("".join(out)) if row["way"] == "cube"}
    assert captures == {"kitchen": 162, "shop": 162, "all worlds": 324}
    assert omniscv("dataset make --limit 4")[0] == 0
    frames = map(json.loads, Path("images/frames.jsonl").read_text(encoding="utf-8").splitlines())
    assert all(frame["key"].startswith(f"{frame['world']}-panorama-") for frame in frames)
