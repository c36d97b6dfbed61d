"""Which plugin a server runs, and which commands it has: by its list, its help, or how it answers."""

from contextlib import closing
from pathlib import Path

import pytest
from support.unreal import relayed
from support.worlds import serve

from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.protocol import DIALECTS

LEVEL, BOUNDS = "vget /level/name", "vget /object/[str]/bounds"
METHOD, CINE = "vset /camera/[uint]/exposure_method [str]", "vget /camera/[uint]/cine/enabled"
HAVE = {
    "0.3.10": set(), "M": {LEVEL, BOUNDS}, "N1": {BOUNDS, LEVEL}, "N2": {BOUNDS, LEVEL, METHOD},
    "N3": {BOUNDS, LEVEL, METHOD, CINE},
}  # fmt: skip


def plugin_of(uri):
    host, _, port = uri.removeprefix("unreal://").partition(":")
    with closing(Connection((host, int(port)))) as connection:
        return connection.plugin


def supported(plugin):
    return {template for template in (LEVEL, BOUNDS, METHOD, CINE) if template in plugin.templates}


@pytest.mark.parametrize("dialect", HAVE)
def test_commands_are_known_from_the_list_or_the_help_and_without_both_by_the_dialect(dialect):
    def no_texts(command, forward):
        return "error no" if command.endswith(("/commands", "/help")) else forward(command)

    with serve(dialect) as server:
        plugin = plugin_of(server.uri)
        assert (plugin.dialect, supported(plugin)) == (dialect, HAVE[dialect])
        assert DIALECTS[dialect].batches == (dialect in ("N2", "N3"))
        with relayed(server, no_texts) as uri:
            without = plugin_of(uri)
    # Without its list N3 answers as N2 does, and the commands of cine cameras are not known.
    assert without.dialect == ("N2" if dialect == "N3" else dialect)
    assert supported(without) == HAVE[dialect] - {CINE}


def test_a_list_that_does_not_hold_itself_is_not_believed():
    def short(command, forward):
        return "vget /camera/[uint]/cine/enabled" if command.endswith("/commands") else forward(command)

    with serve("N1") as server, relayed(server, short) as uri:
        plugin = plugin_of(uri)
    assert (plugin.dialect, supported(plugin)) == ("N1", HAVE["N1"])


def test_the_dev_build_which_names_cameras_in_another_way_is_taken_for_n3():
    def dev(command, forward):
        reply = forward(command)
        return reply.replace(b"[uint]", b"[camera_id]") if command.endswith("/commands") else reply

    with serve("N3") as server, relayed(server, dev) as uri:
        plugin = plugin_of(uri)
    assert plugin.dialect == "N3"
    assert CINE in plugin.templates


def test_the_documents_have_the_table():
    text = Path(__file__).parents[3].joinpath("docs", "engines.md").read_text()
    for name, dialect in DIALECTS.items():
        assert f"| {name} | {dialect.plugin} | {dialect.engine} |" in text
