"""Commands that make something: demo, render, record, serve."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from omniscv.cli import options
from omniscv.cli.progress import err, progress_bar
from omniscv.cli.progress import out as console
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.job import Job

JobFile = Annotated[Path | None, typer.Argument(metavar="[JOB.yaml]", help="A job; instead of options.")]
SourceUri = Annotated[
    str, typer.Option("--source", help="unreal://host:port, mock://room, or a recorded file.")
]
CameraName = Annotated[str, typer.Option("--camera", help="A camera model; 'omniscv cameras' lists them.")]
Size = Annotated[str, typer.Option("--size", help="Image size, px.")]
Fov = Annotated[float | None, typer.Option("--fov", help="Full field of view, degrees.")]
Params = Annotated[
    list[str] | None, typer.Option("--param", help="A camera parameter NAME=VALUE; repeatable.")
]
Position = Annotated[str, typer.Option("--position", help="X,Y,Z in metres: X forward, Y left, Z up.")]
Yaw = Annotated[float, typer.Option("--yaw", help="Degrees, to the left +.")]
Pitch = Annotated[float, typer.Option("--pitch", help="Degrees, nose up +.")]
Roll = Annotated[float, typer.Option("--roll", help="Degrees, right side down +.")]
Modes = Annotated[str, typer.Option("--modes", help="Some of lit,object_mask,depth,normal.")]
Record = Annotated[
    Path | None, typer.Option("--record", help="Keep captures in this file; take from it what it has.")
]
Strategy = Annotated[str, typer.Option("--strategy", help="auto, cube, faces, strips or adaptive.")]
Viewpoints = Annotated[
    int | None, typer.Option("--viewpoints", help="Optical centres of a non-central camera.")
]
FaceSize = Annotated[str, typer.Option("--face-size", help="px of a 90 degree face, or auto.")]
Filter = Annotated[str, typer.Option("--filter", help="auto, nearest, bilinear, bicubic or area.")]
MaxError = Annotated[str | None, typer.Option("--max-error", help="What 'adaptive' may err, such as 0.5px.")]


def add_to(app: typer.Typer) -> None:
    """Adds the commands."""
    app.command(epilog="Example: omniscv demo out/")(demo)
    app.command(
        epilog="Example: omniscv render --source mock://four-wall --camera fisheye-equidistant "
        "--size 1024x1024 --fov 185 --position 0,0,1.5 --modes lit,depth --out out/"
    )(render)
    app.command(
        epilog="Example: omniscv record --source unreal://localhost:9000 --position 0,0,1.5 "
        "--face-size 1024 --modes lit,mask,depth --out kitchen.sqlite"
    )(record)
    app.command(epilog="Example: omniscv serve four-wall --port 9000 --dialect 0.3.10")(serve)


def make_job(
    job: Path | None = None,
    source: str = "mock://four-wall",
    camera: str = "equirectangular",
    size: str = "1024x512",
    fov: float | None = None,
    param: list[str] | None = None,
    position: str = "0,0,1.5",
    yaw: float = 0.0,
    pitch: float = 0.0,
    roll: float = 0.0,
    modes: str = "lit",
    out: Path = Path("out"),
    stem: str | None = None,
    record: Path | None = None,
    strategy: str = "auto",
    viewpoints: int | None = None,
    face_size: str = "auto",
    filter: str = "auto",
    max_error: str | None = None,
    image_format: str = "png",
) -> Job:
    """A job from its file, or from options."""
    if job is not None:
        from omniscv.job import load

        return load(job)
    return Job(
        source=source,
        cameras={stem or camera: options.camera(camera, size, fov, param or [])},
        poses=(Pose.from_angles(options.numbers("--position", position, 3), yaw, pitch, roll),),
        out=out,
        modes=options.modes(modes),
        record=record,
        strategy=strategy,
        viewpoints=viewpoints,
        face_size=options.face_size(face_size),
        filter=filter,
        max_error_px=None if max_error is None else options.pixels("--max-error", max_error),
        image_format=image_format,
    )


def demo(
    out: Annotated[Path, typer.Argument(help="Folder for images, records and contact sheets.")] = Path(
        "out/demo"
    ),
) -> None:
    """The main job, once, without Unreal: capture rooms over TCP, compose every camera, replay."""
    from omniscv.demo import run_demo

    with progress_bar("demo") as progress:
        report = run_demo(out, progress)
    for line in report.lines():
        console.print(line, markup=False)


def render(
    job: JobFile = None,
    source: SourceUri = "mock://four-wall",
    camera: CameraName = "equirectangular",
    size: Size = "1024x512",
    fov: Fov = None,
    param: Params = None,
    position: Position = "0,0,1.5",
    yaw: Yaw = 0.0,
    pitch: Pitch = 0.0,
    roll: Roll = 0.0,
    modes: Modes = "lit",
    out: Annotated[Path, typer.Option("--out", help="Folder for the images.")] = Path("out"),
    stem: Annotated[
        str | None, typer.Option("--stem", help="Start of the file names; the camera's name.")
    ] = None,
    record: Record = None,
    strategy: Strategy = "auto",
    viewpoints: Viewpoints = None,
    face_size: FaceSize = "auto",
    filter: Filter = "auto",
    max_error: MaxError = None,
    image_format: Annotated[str, typer.Option("--image-format", help="png, jxl or jpg for lit.")] = "png",
) -> None:
    """Compose images and their ground truth."""
    from omniscv.job import run

    wanted = make_job(
        job, source, camera, size, fov, param, position, yaw, pitch, roll, modes, out, stem, record,
        strategy, viewpoints, face_size, filter, max_error, image_format,
    )  # fmt: skip
    with progress_bar("images") as progress:
        files = run(wanted, progress, warn=lambda line: err.print(f"omniscv: {line}", markup=False))
    for path in files:
        console.print(str(path), markup=False)


def record(
    job: JobFile = None,
    source: Annotated[
        list[str] | None,
        typer.Option("--source", help="As for render; repeatable: several games share the captures out."),
    ] = None,
    launch: Annotated[
        list[Path] | None,
        typer.Option("--launch", help="A packaged game, to start and to stop at the end; repeatable."),
    ] = None,
    position: Annotated[
        list[str] | None, typer.Option("--position", help="X,Y,Z in metres; repeatable.")
    ] = None,
    face_size: FaceSize = "1024",
    modes: Modes = "lit,object_mask,depth",
    fix_exposure: Annotated[
        bool, typer.Option("--fix-exposure", help="Turn vignette and auto exposure off in the game.")
    ] = False,
    overscan: Annotated[
        int | None,
        typer.Option("--overscan", min=0, help="px beyond a face on every side, to be cropped."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The file to record into.")] = Path("capture.sqlite"),
) -> None:
    """Capture cube maps at positions (or all that a job needs) into a file; goes on where it stopped."""
    from omniscv.job import capture, load

    edge = options.face_size(face_size)
    launched = [options.launched(path, edge) for path in launch or []]
    sources = (*(source or []), *launched)
    if job is not None:
        wanted = load(job)
        if sources:
            wanted = replace(wanted, source=sources)
    else:
        width = 2 * edge if isinstance(edge, int) else 2048
        wanted = Job(
            source=sources or "mock://four-wall",
            cameras={"cube": options.camera("equirectangular", f"{width}x{width // 2}", None, [])},
            poses=tuple(
                Pose.from_angles(options.numbers("--position", text, 3)) for text in position or ["0,0,1.5"]
            ),
            out=out.parent,
            modes=options.modes(modes),
            record=out,
            strategy="cube",
            face_size=edge,
        )
    if fix_exposure:
        wanted = replace(wanted, source_options={**wanted.source_options, "fix_exposure": True})
    with progress_bar("captures") as progress:
        done = capture(wanted, wanted.record or out, progress, border_px=overscan)
    console.print(f"{wanted.record or out}: {done} captures", markup=False)


def serve(
    scene: Annotated[str, typer.Argument(help="A room's name or a YAML file.")] = "four-wall",
    port: Annotated[int, typer.Option(help="0 takes any free port.")] = 9000,
    dialect: Annotated[str, typer.Option(help="What the server speaks.")] = "1.x",
    latency_ms: Annotated[float, typer.Option(help="Added to every reply, as a live engine has.")] = 0.0,
    depth: Annotated[str, typer.Option(help="half, as real servers send it, or float32.")] = "half",
    host: Annotated[str, typer.Option(help="The address to listen on.")] = "127.0.0.1",
    size: Annotated[
        str, typer.Option(help="WIDTHxHEIGHT of pictures and window; plugin 0.3.10 cannot set it.")
    ] = "640x480",
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME[=VALUE][@PROBABILITY], such as delay=0.2@0.05; repeatable. See mock_server.faults."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the faults' dice.")] = 0,
) -> None:
    """The mock server: a room behind the UnrealCV protocol, for any client. Ctrl-C stops it."""
    import threading

    import mock_server

    try:
        server = mock_server.serve(
            scene,
            port=port,
            dialect=dialect,
            latency_ms=latency_ms,
            depth=depth,
            host=host,
            size=options.size(size),
            faults=fault or (),
            seed=seed,
        )
    except ValueError as wrong:
        raise ArgumentError(str(wrong)) from wrong
    with server:
        console.print(
            f"{server.scene.name} at {server.uri}, dialect {dialect}; Ctrl-C stops it", markup=False
        )
        threading.Event().wait()
