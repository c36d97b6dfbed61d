"""Every command's help has an example, and the example runs."""

import pytest
from support.command_line import example_inputs, run
from support.documents import examples
from typer.main import get_command

from omniscv.cli import app


def leaves(command, words=("omniscv",)):
    """Every command of a tree that has no commands below it, with its words."""
    below = getattr(command, "commands", None)
    if not below:
        return {" ".join(words): command}
    return {name: leaf for word, each in below.items() for name, leaf in leaves(each, (*words, word)).items()}


COMMANDS = leaves(get_command(app))


def test_commands_are_found():
    assert {"omniscv serve", "omniscv captures info"} <= set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_a_command_runs(name, folder, ports):
    command = COMMANDS[name]
    found = examples(f"{command.help}\n\n{command.epilog}")
    assert found, f"{name}: expected 'Example: {name} ...' in its help"
    assert all(" ".join(words).startswith(name) for words in found)
    example_inputs(
        folder, faces=name != "omniscv captures export", dataset=name.startswith("omniscv dataset ")
    )
    for words in found:
        run(words, ports)
