"""The reading and running of documents, on a document made up here."""

import pytest
from support.documents import blocks, examples, shrunk, unfenced
from test_documents import execute

DOCUMENT = """
```yaml
# ball.yaml
objects: {Ball: {solids: [{sphere: 0.2, at: [1, 0, 1]}]}}
```

1. In a list:

   ```python
   x = 1
   x / 0
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
    assert [block.language for block in found] == ["yaml", "python", "sh", "text"]
    assert [block.file_name() for block in found] == ["ball.yaml", None, None, None]
    record = ["omniscv", "record", "--position", "0,0,1.5", "--out", "room.sqlite"]
    assert [block.commands() for block in found] == [[], [], [record, ["./scripts/test"]], []]
    assert unfenced(DOCUMENT) == []
    assert unfenced("    omniscv demo\n") == ["    omniscv demo"]


def test_an_error_has_the_line_of_the_document(folder):
    with pytest.raises(ZeroDivisionError) as failed:
        execute(blocks(DOCUMENT), "made-up.md", folder, {9000: 1})
    last = failed.traceback[-1]
    assert (str(last.path).endswith("made-up.md"), last.lineno + 1) == (True, 11)


def test_sizes_shrink_and_examples_are_found():
    assert shrunk("width=1024, height=768 --size 2048x1024") == "width=128, height=96 --size 256x128"
    assert shrunk("image_width: 1280 fov_deg=185") == "image_width: 1280 fov_deg=185"
    text = "Compose.\n\nExample: omniscv render a.yaml\n  --out b\n\nMore. Example: omniscv plan 'a b'"
    assert examples(text) == [["omniscv", "render", "a.yaml", "--out", "b"], ["omniscv", "plan", "a b"]]
