"""Every command's help has an example, which runs; it is parsed where a document runs the command."""

import contextlib
import shutil

import pytest
from support.command_line import ROOT, example_inputs, name_of, run
from support.documents import examples
from test_documents import BY_NAME, commands
from typer.main import get_command

from omniscv.cli import app


def leaves(command, words=("omniscv",)):
    """Every command of a tree that has no commands below it, with its words."""
    below = getattr(command, "commands", None)
    if not below:
        return {" ".join(words): command}
    return {
        name: leaf
        for word in below
        if not (each := command.get_command(None, word)).hidden
        for name, leaf in leaves(each, (*words, word)).items()
    }


COMMANDS = leaves(get_command(app))
DOCUMENTED = {name_of(words) for name in BY_NAME for words in commands(name)}


assert {"omniscv serve", "omniscv recording info"} <= set(COMMANDS)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    made = tmp_path_factory.mktemp("inputs")
    shutil.copytree(ROOT / "captures", made / "captures")
    with contextlib.chdir(made):
        example_inputs(made)
    return made


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_a_command_runs(name, folder, ports, request):
    command = COMMANDS[name]
    found = examples(f"{command.help}\n\n{command.epilog}")
    assert found, f"{name}: expected 'Example: {name} ...' in its help"
    assert all(" ".join(words).startswith(name) for words in found)
    if name.removeprefix("omniscv ") not in DOCUMENTED:
        shutil.copytree(request.getfixturevalue("inputs"), folder, dirs_exist_ok=True)
    if name == "omniscv recording export":
        shutil.rmtree("faces", ignore_errors=True)  # what it makes
    for words in found:
        run(words, ports, parsed_only=name_of(words) in DOCUMENTED)
