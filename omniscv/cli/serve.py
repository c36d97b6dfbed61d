"""``omniscv serve``: the mock server."""

from typer import Argument, Option, Typer

from omniscv.cli import console, options, signals
from omniscv.errors import ArgumentError, OmniscvError

app = Typer(add_completion=False)


class ServeOptions(options.Options):
    """What the server shows, and how it behaves."""

    scene: str = Argument("four-wall", help="A scene's name, or a YAML file.")
    port: int = Option(9000, help="0 takes any free port.")
    dialect: str = Option("1.x", help="The dialect of UnrealCV: 1.x, 0.3.10, M, N1 or N2.")
    latency_ms: float = Option(0.0, help="Added to every reply, as by a live engine.")
    depth: str = Option("half", help="half, as real servers send it, or float32.")
    host: str = Option("127.0.0.1", help="The address to listen on.")
    size: str = Option("640x480", help="Of images and window, px; clients of 0.3.10 cannot set it.")
    faults: list[str] = Option(
        [], "--fault", help="As delay=0.2@0.05; see python -m mock_server -h; repeatable."
    )
    time_step_s: float = Option(1 / 60, "--time-step", help="Seconds of a moving scene's clock in a frame.")
    seed: int = Option(0, help="Of the faults' random numbers.")


@app.command(epilog="Example: omniscv serve four-wall --port 9000 --dialect 0.3.10 --size 512x512")
@ServeOptions.command
def serve(given: ServeOptions) -> None:
    """Serve a scene over the UnrealCV protocol, for any client, until Ctrl-C."""
    import mock_server

    with mock_server.stop_signal() as wait:
        signals.check()
        try:
            server = mock_server.serve(**{**given.values, "size": options.size(given.size)})
        except ValueError as wrong:
            raise ArgumentError(str(wrong)) from wrong
        except OSError as cause:
            raise OmniscvError(f"serve: expected to listen on {given.host}:{given.port}; {cause}") from cause
        with server:
            console.line(f"{server.scene.name} at {server.uri}, dialect {given.dialect}; Ctrl-C stops it")
            if wait(server) is None:
                raise OmniscvError(f"serve: {server.fault or 'the server has ended'}")
