"""What errors tell a user to type: each option and command exists, and each remedy works as it is printed."""

import ast
import re
import shlex
from fnmatch import fnmatch
from types import SimpleNamespace

import pytest
from PIL import Image
from support.command_line import ROOT
from support.datasets import job_file, tree
from typer.main import get_command

import omniscv
from omniscv import cli, dataset, truth
from omniscv.errors import ExistingDatasetError
from omniscv.sources.recording.inspection import info

NAMED = re.compile(r"(?<![\w-])--[a-z][a-z-]*|(?<=')omniscv [a-z ]+")
OPTIONS_OF = {
    "calibration/forms.py": "render",
    "calibration/opencv.py": "render, cameras convert",
    "cli/__init__.py": "render, doctor, ",
    "cli/cameras.py": "render, cameras convert, cameras fit",
    "cli/console.py": "render",
    "cli/dataset.py": "dataset make, dataset card, dataset pack, dataset video",
    "cli/images.py": "render, record, job",
    "cli/options.py": "render, doctor, job",
    "cli/recording.py": "recording import",
    "cli/remedies.py": "dataset make",
    "cli/reports.py": "chart",
    "cli/reprojecting.py": "reproject",
    "cli/scoring.py": "score",
    "cli/servers.py": "doctor",
    "cluster/*": "dataset make",
    "dataset/exporting.py": "dataset export",
    "dataset/formats/webdataset.py": "dataset pack",
    "diagnostics/*": "doctor, record, recording import, render",
    "geometry/trajectory_columns.py": "recording import",
    "importing/*": "recording import",
    "job/file.py": "render",
    "make/dataset.py": "dataset make",
    "score/*": "score",
    "sources/pictures.py": "recording import",
    "sources/recording/files.py": "recording import",
    "sources/stillness.py": "render",
    "sources/tagged_colors.py": "recording import",
    "sources/unreal/*": "render",
}
"""By the file of a message, the commands whose options it may name."""
OF_OTHERS = {
    "dask worker": {"cluster/workers.py": "--resources", "cluster/inside.py": "--name"},
    "blender": {"sources/blender/__init__.py": "--background --factory-startup --disable-autoexec "
                "--python-exit-code --python"},
    "pytest": {"testing/__init__.py": "--record-mode --unrealcv"},
    "pip": {"diagnostics/installation.py": "--upgrade"},
    "omniscv serve": {"diagnostics/installation.py": "--port"},
}  # fmt: skip
"""Options of other programs, and of ``serve``, which hands its own to the mock, by files that name them."""


def messages(path):
    """Yield the texts of a module that may be printed: neither docstrings nor the help of options."""
    silent = set()
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    for node in nodes:
        is_option = isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Option"
        if isinstance(node, ast.Expr) or is_option or getattr(node, "arg", "") in ("help", "epilog"):
            silent.update(map(id, ast.walk(node)))
        elif isinstance(node, ast.JoinedStr):
            silent.update(map(id, node.values))
    for node in nodes:
        if id(node) in silent:
            continue
        if isinstance(node, ast.JoinedStr):
            yield "".join(getattr(part, "value", "{}") if isinstance(part, ast.Constant) else "{}"
                          for part in node.values)  # fmt: skip
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def named():
    """Return (file, option or command) of all that messages of the package name."""
    package = ROOT / "omniscv"
    pairs = set()
    for path in package.rglob("*.py"):
        for text in messages(path):
            for name in NAMED.findall(text):
                pairs.add((path.relative_to(package).as_posix(), name.strip()))
    return sorted(pairs)


def command(words):
    """Return the longest command that words begin with, and how many words it takes; None without one."""
    group = get_command(cli.app)
    if not words:
        return group, 0
    for count, word in enumerate(words):
        known = group.get_command(None, word) if hasattr(group, "get_command") else None
        if known is None:
            return (group, count) if count else (None, 0)
        group = known
    return group, len(words)


def options_of(line):
    options = {"--help"}
    for parameter in command(line.split())[0].params:
        options.update(parameter.opts)
    return options


def fault(file, name):
    """Return what is wrong with an option or command that a file names; empty if nothing is."""
    if name.startswith("omniscv"):
        return "" if command(name.split()[1:])[0] else "no such command"
    if any(name in files.get(file, "").split() for files in OF_OTHERS.values()):
        return ""
    lines = [lines for pattern, lines in OPTIONS_OF.items() if fnmatch(file, pattern)]
    if not lines:
        return "expected a row of OPTIONS_OF"
    return "" if any(name in options_of(line) for line in lines[0].split(", ")) else "no such option"


def test_every_command_and_option_that_a_message_names_exists():
    pairs = named()
    assert len(pairs) > 90
    assert [(*pair, fault(*pair)) for pair in pairs if fault(*pair)] == []


# -- remedies that are typed -----------------------------------------------------------------------------


@pytest.fixture
def room(tmp_path, monkeypatch):
    """The folder of a job of six frames, ``dataset.yaml``, in which commands are typed."""
    monkeypatch.chdir(tmp_path)
    job_file(tmp_path)
    return tmp_path


def printed_command(capsys, code, line):
    """Type a line, and return the command line that its last line of errors ends with."""
    assert cli.run(shlex.split(line)[1:]) == code
    last = capsys.readouterr().err.splitlines()[-1]
    return re.search(
        r"(?:: |')(omniscv [^']*(?:'[^']*')?[^']*?)'?(?: (?:lists|has|adds) .*|, and .*|)$", last
    )[1]


def typed(line):
    return cli.run(shlex.split(line)[1:])


@pytest.fixture
def calm(monkeypatch):
    """A truth of the job that calls a function, which may be replaced, with each frame."""
    truths = SimpleNamespace(derive=lambda frame: {})
    truth.registry.names()
    of_frame = truth.registry.Truth("calm", lambda frame, options: truths.derive(frame))
    monkeypatch.setitem(truth.registry._TRUTHS, "calm", of_frame)
    return truths


@pytest.mark.parametrize("more", ["", " --workers 2 --overwrite", " --set 'truth.calm=true' --overwrite"])
def test_a_stopped_dataset_goes_on_by_the_line_that_is_printed(room, calm, capsys, more):
    frames = []

    def stop(frame):
        frames.append(frame)
        if len(frames) == 3:
            raise KeyboardInterrupt
        return {}

    job_file(room, more="truth: {calm: true}\n")
    if more:
        assert typed("omniscv dataset make dataset.yaml") == 0
    calm.derive = stop
    goes_on = printed_command(capsys, 130, f"omniscv dataset make dataset.yaml{more}")
    assert goes_on == f"omniscv dataset make dataset.yaml{more}".replace(" --overwrite", "").replace("'", "")
    calm.derive = lambda frame: {}
    assert typed(goes_on) == 0
    assert re.search(r"[345] frames made, [123] kept; complete", capsys.readouterr().out)
    assert dataset.check("dataset", deep=True) == []


def test_a_dataset_of_another_job_is_replaced_by_the_line_that_is_printed(room, capsys):
    assert typed("omniscv dataset make dataset.yaml --limit 1") == 0
    replaces = printed_command(capsys, 2, "omniscv dataset make dataset.yaml --limit 1 --set 'face_size=64'")
    assert typed(replaces) == 0
    assert dataset.check("dataset", deep=True) == []


def test_failed_frames_are_tried_again_by_the_line_that_is_printed(room, calm, capsys):
    def fail(frame):
        raise omniscv.errors.DatasetError("expected a calm sea")

    job_file(room, more="truth: {calm: true}\n")
    calm.derive = fail
    again = printed_command(capsys, 1, "omniscv dataset make dataset.yaml --keep-going --limit 2")
    calm.derive = lambda frame: {}
    assert typed(again) == 0
    assert dataset.check("dataset", deep=True) == []


def test_a_dataset_without_a_list_says_who_completes_it(room, capsys):
    assert typed("omniscv dataset make dataset.yaml --limit 1") == 0
    (room / "dataset" / "frames.jsonl").unlink()
    capsys.readouterr()
    assert typed("omniscv dataset export dataset --to coco") == 1
    said = capsys.readouterr().err
    assert "'omniscv dataset make JOB' with its job completes it" in said
    assert typed("omniscv dataset make dataset.yaml --limit 1") == 0
    assert typed("omniscv dataset export dataset --to coco") == 0


def test_an_interrupted_loop_goes_on_by_what_its_error_says(tmp_path):
    out = tmp_path / "own"
    camera = omniscv.cameras.create("equirectangular", width=32, height=16)
    images = []

    def loop(**how):
        with omniscv.open_source("scene://four-wall") as source, dataset.Writer(out, **how) as writer:
            for index in range(3):
                if f"turn-{index}" in writer:
                    continue
                pose = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=60 * index)
                images.append(omniscv.render(camera, pose, source, ("lit",), face_size=32))
                writer.add(f"turn-{index}", images[-1])
                if len(images) == 2:
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        loop()
    with pytest.raises(omniscv.errors.DatasetError, match=r"the loop .* dataset.Writer\(out, resume=True\)"):
        dataset.open(out)
    with pytest.raises(ExistingDatasetError, match=r"; dataset.Writer\(out, resume=True\) goes on with it"):
        loop()
    loop(resume=True)
    assert len(images) == 3
    assert [frame.key for frame in dataset.open(out)] == ["turn-0", "turn-1", "turn-2"]
    assert dataset.check(out, deep=True) == []
    whole = tree(out)
    loop(resume=True)
    assert tree(out) == whole


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("omniscv render --camera pinhole --set camera.fov=9 --size 8x4", 0),
        ("omniscv render --source seen.sqlite --position 4,0,1.5 --size 8x4", 0),
        ("omniscv render --source seen.png --size 8x4", 0),
    ],
    ids=["example of a camera", "places of a recording", "import of a picture"],
)
def test_commands_in_quotes_work(tmp_path, monkeypatch, capsys, line, code):
    monkeypatch.chdir(tmp_path)
    assert typed("omniscv record --set face_size=32 --modes lit --out seen.sqlite") == 0
    Image.new("RGB", (64, 32)).save("seen.png")
    (tmp_path / "seen.sqlite").rename("old") if "seen.png" in line else None
    capsys.readouterr()
    assert typed(line) != 0
    (advice, *_) = re.findall(r"'(omniscv (?:[^']|'[^']*')*?)'", capsys.readouterr().err)
    assert typed(advice) == code


def test_a_stopped_recording_goes_on_by_the_line_that_is_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    line = "omniscv record --set face_size=32 --modes lit --out room.sqlite --position=0,0,1.5"
    with monkeypatch.context() as patch:
        patch.setattr(
            "omniscv.make.render._capture_moment", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
        )
        goes_on = printed_command(capsys, 130, line)
    assert typed(goes_on) == 0
    assert info("room.sqlite").captures == {"lit": 6}
