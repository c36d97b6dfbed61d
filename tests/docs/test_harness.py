"""The reading and running of documents, on documents made up here."""

import click
import pytest
from support import command_line
from support.documents import at_ports, blocks, examples, shrunk, unfenced
from test_documents import execute

DOCUMENT = """
# Title

```yaml
# ball.yaml
objects: {Ball: {solids: [{sphere: 0.2, at: [1, 0, 1]}]}}
```

```python
import mock_server
scene = mock_server.load_scene("ball.yaml")
```

1. In a list:

   ```python
   (label,) = scene.trace((0, 0, 1), [[1, 0, 0]]).label
   ```

```sh
$ omniscv record --position 0,0,1.5 \\
    --out room.sqlite   # a comment
ls
./scripts/test
```

```text
omniscv fly
```
"""


def test_blocks_of_a_document():
    found = blocks(DOCUMENT)
    assert [block.language for block in found] == ["yaml", "python", "python", "sh", "text"]
    assert [block.file_name() for block in found] == ["ball.yaml", None, None, None, None]
    assert found[2].text.startswith("(label,) = ")
    lines = DOCUMENT.split("\n")
    assert lines[found[1].line - 1] == "import mock_server"
    record = ["omniscv", "record", "--position", "0,0,1.5", "--out", "room.sqlite"]
    assert [block.commands() for block in found] == [[], [], [], [record, ["./scripts/test"]], []]


def test_an_error_has_the_line_of_the_document(folder):
    with pytest.raises(ZeroDivisionError) as failed:
        execute(blocks("a\n\n```python\nx = 1\nx / 0\n```\n"), "made-up.md", folder, {9000: 1})
    last = failed.traceback[-1]
    assert (str(last.path).endswith("made-up.md"), last.lineno + 1) == (True, 5)


@pytest.mark.parametrize(
    ("text", "smaller"),
    [
        ('create("pinhole", width=1024, height=768)', 'create("pinhole", width=128, height=96)'),
        ("--size 2048x1024 --face-size 512", "--size 256x128 --face-size 64"),
        ("--size 24x240 --overscan 512", "--size 24x32 --overscan 64"),
        ("fisheye: {width: 256, height: 128}", "fisheye: {width: 32, height: 32}"),
        ("image_width: 1280", "image_width: 1280"),
        ("mock://four-wall?dialect=0.3.10&size=512x512", "mock://four-wall?dialect=0.3.10&size=64x64"),
        ("fov_deg=185, --position 0,0,1.5", "fov_deg=185, --position 0,0,1.5"),
    ],
)
def test_sizes_shrink(text, smaller):
    assert shrunk(text) == smaller


def test_addresses_are_those_of_servers_that_run():
    text = "unreal://localhost:9000 unreal://localhost:9001"
    assert at_ports(text, {9000: 41, 9001: 42}) == "unreal://localhost:41 unreal://localhost:42"


def test_commands_without_a_fence_are_found():
    assert unfenced(DOCUMENT) == []
    assert unfenced("    omniscv demo\n\n```\n./scripts/test\n```\n`omniscv look`\n") == [
        "    omniscv demo",
        "./scripts/test",
    ]


def test_examples_of_a_help_text():
    text = "Compose.\n\nExample: omniscv render a.yaml\n  --out b\n\nMore. Example: omniscv plan 'a b'"
    assert examples(text) == [["omniscv", "render", "a.yaml", "--out", "b"], ["omniscv", "plan", "a b"]]
    assert examples("None") == []


def test_a_command_line_is_parsed_without_running_it():
    @click.group()
    def tool(): ...

    @tool.command()
    @click.option("--size", type=int)
    def demo(size):
        raise AssertionError("must not run")

    command_line.parse(tool, ["demo", "--size", "3"])
    with pytest.raises(click.UsageError, match="--sise"):
        command_line.parse(tool, ["demo", "--sise", "3"])
