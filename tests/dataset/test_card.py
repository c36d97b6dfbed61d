"""Cards of datasets: what they say is what the files hold, and nobody else's page is replaced."""

import hashlib
import json

import numpy as np
import pytest
import yaml

from omniscv import dataset
from omniscv.cli import run
from omniscv.job import read
from omniscv.make import make

JOB = {
    "source": "scene://four-wall",
    "cameras": {
        "pano": {"model": "equirectangular", "width": 32, "height": 16},
        "fish": {"model": "fisheye-equidistant", "width": 16, "height": 16, "fov_deg": 185},
    },
    "poses": [{"position": [0, 0, 1.5], "yaw_deg": 40}, {"position": [0.5, 0, 1.5]}],
    "modes": ["lit", "mask", "depth"],
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("carded") / "rooms"
    make(read({**JOB, "out": str(out)}, out.parent))
    assert run(["dataset", "card", str(out), "--license", "CC-BY-4.0", "--creator", "A Group"]) == 0
    return out


def test_the_front_matter_is_yaml_and_says_tasks_and_size(made):
    _, front, _ = (made / "README.md").read_text().split("---\n", 2)
    front = yaml.safe_load(front)
    assert front["license"] == "cc-by-4.0"
    assert set(front["task_categories"]) == {"depth-estimation", "image-segmentation"}
    assert front["size_categories"] == ["n<1K"]
    assert front["pretty_name"] == "rooms"


def test_the_card_says_the_share_of_pixels_in_doubt(made):
    shares = [frame.layer("label_edge")[frame.valid].mean() for frame in dataset.open(made)]
    assert f"`label_edge`: {100 * np.mean(shares):.3g} %" in (made / "README.md").read_text()


def test_croissant_names_files_by_their_bytes_and_columns_that_are_there(made):
    croissant = json.loads((made / "croissant.json").read_text())
    assert croissant["conformsTo"].endswith("/1.1")
    for file in croissant["distribution"]:
        content = (made / file["contentUrl"]).read_bytes()
        assert file["sha256"] == hashlib.sha256(content).hexdigest()
    lines = [json.loads(line) for line in (made / "frames.jsonl").read_text().splitlines()]
    (records,) = croissant["recordSet"]
    for field in records["field"]:
        column = field["source"]["extract"]["column"]
        assert all(isinstance(line[column], str) for line in lines)


def test_archives_get_licence_and_creator(made):
    zenodo = json.loads((made / ".zenodo.json").read_text())
    assert (zenodo["license"], zenodo["creators"]) == ("CC-BY-4.0", [{"name": "A Group"}])
    codemeta = json.loads((made / "codemeta.json").read_text())
    assert codemeta["license"] == "https://spdx.org/licenses/CC-BY-4.0"


def test_a_dataset_with_a_card_has_no_faults_and_the_card_is_renewed(made, capsys):
    assert run(["dataset", "check", str(made), "--deep"]) == 0
    assert run(["dataset", "card", str(made)]) == 0
    assert "license: unknown" in (made / "README.md").read_text()
    assert "--license states one" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["README.md", "croissant.json", "codemeta.json", ".zenodo.json"])
def test_files_of_somebody_else_stay(made, capsys, name):
    for other in ("README.md", "croissant.json", "codemeta.json", ".zenodo.json"):
        (made / other).unlink(missing_ok=True)
    (made / name).write_text("mine")
    assert run(["dataset", "card", str(made)]) == 2
    assert (made / name).read_text() == "mine"
    assert "move yours away" in capsys.readouterr().err
    (made / name).unlink()


def test_a_dataset_says_no_address_that_it_does_not_have(made):
    assert run(["dataset", "card", str(made), "--license", "CC0-1.0"]) == 0
    assert "url" not in json.loads((made / "croissant.json").read_text())
    assert (
        run(["dataset", "card", str(made), "--license", "CC0-1.0", "--url", "https://example.org/rooms"]) == 0
    )
    assert json.loads((made / "croissant.json").read_text())["url"] == "https://example.org/rooms"
