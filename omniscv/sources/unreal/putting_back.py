"""Puts back what a layer of the journal took in."""

from omniscv.errors import ServerRefusedError
from omniscv.sources.unreal.exchange import Exchange
from omniscv.sources.unreal.journal import Journal, Key, Layer


def put_back(exchange: Exchange, journal: Journal, layer: Layer) -> None:
    """Undo a layer's changes, the last one first; what is refused does not keep others from being undone.

    Raises:
        SourceError: the server is gone, or what it refused first; the state keeps what was not put back. None
            where turns are over: closing the source has put back all it could.
    """
    with exchange.lock:
        journal.close(layer)
        if not layer or exchange.closed:
            return
        fault: ServerRefusedError | None = None
        for keys in _steps(layer):
            try:
                _undo(exchange, journal, layer, keys)
            except ServerRefusedError as refused:
                fault = fault or refused
                for key in keys:
                    try:
                        _undo(exchange, journal, layer, [key])
                    except ServerRefusedError:
                        continue
        exchange.settle()
        if fault is not None:
            raise fault


def _steps(layer: Layer) -> list[list[Key]]:
    """Return the keys from the last to the first; those that only take commands go together."""
    steps: list[list[Key]] = []
    for key in reversed(layer):
        alone = layer[key][1].run is not None
        if alone or not steps or layer[steps[-1][0]][1].run is not None:
            steps.append([])
        steps[-1].append(key)
    return steps


def _undo(exchange: Exchange, journal: Journal, layer: Layer, keys: list[Key]) -> None:
    undone = [layer[key][1] for key in keys if key in layer]
    exchange.do([command for undo in undone for command in undo.commands])
    for undo in undone:
        if undo.run is not None:
            undo.run()
    for key in keys:
        journal.undone(layer, key)
