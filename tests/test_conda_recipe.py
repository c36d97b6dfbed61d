"""The conda recipe has what the package says of itself: py-rattler-build, which parses it, is in no lock."""

import re
import tomllib

import yaml
from support.command_line import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RECIPE = yaml.safe_load((ROOT / "recipe/recipe.yaml").read_text(encoding="utf-8"))
CONDA_NAMES = {
    "opencv-python": "py-opencv",
    "openimageio": "py-openimageio",
    "zlib-ng": "python-zlib-ng",
}


def name_and_bounds(requirement):
    """A requirement's name as conda has it, and its bounds of versions, without a marker."""
    text = requirement.partition(";")[0].strip().lower()
    name = re.match(r"[a-z0-9._-]+", text)[0]
    return CONDA_NAMES.get(name, name), text[len(name) :].strip()


def test_the_recipe_needs_what_the_package_needs():
    needed = set()
    for entry in RECIPE["requirements"]["run"]:
        needed.add(entry["then"] if isinstance(entry, dict) else entry)
    expected = {" ".join(name_and_bounds(requirement)) for requirement in PROJECT["dependencies"]}
    assert needed == expected | {f"python {PROJECT['requires-python']}"}


def test_version_licence_and_command_are_those_of_the_package():
    assert RECIPE["context"]["version"] == PROJECT["version"]
    assert RECIPE["about"]["license"] == PROJECT["license"]
    assert RECIPE["build"]["python"]["entry_points"] == [
        f"{name} = {target}" for name, target in PROJECT["scripts"].items()
    ]
