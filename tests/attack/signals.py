"""Signals to commands at any moment: they end in time, and leave files that open and no process."""

import os
import signal
import time

import psutil
from support.processes import started

from attack.commands import nothing_left, ran, require

SECONDS = 20
PROGRAM = "from omniscv.cli import main; print('started', flush=True); main()"
POSITIONS = [f"--position={0.01 * step},0,1.5" for step in range(300)]
PANORAMA = "--size 64x32 --camera noncentral-panorama --set camera.radius=0.5 --set strategy=cube"
FACES = "--set face_size=32 --modes lit,object_mask,depth --out room.sqlite"
COMMANDS = {
    "record": ["record", *FACES.split(), *POSITIONS],
    "render": ["render", *PANORAMA.split(), "--modes", "lit,depth"],
    "serve": ["serve", "--port", "0"],
}
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL]


def case(rng, folder):
    name = rng.choice(list(COMMANDS))
    number = rng.choice(SIGNALS)
    with nothing_left(folder, may_leave=number == signal.SIGKILL) as work:
        environment = {**os.environ, "TMPDIR": str(folder / "tmp")}
        children = []
        sent = [number]
        with started("-c", PROGRAM, *COMMANDS[name], cwd=work, env=environment) as process:
            process.stdout.readline()
            time.sleep(rng.choice([rng.uniform(0, 0.1), rng.uniform(0, 1.5), rng.uniform(1, 4)]))
            if process.poll() is None:
                children = psutil.Process(process.pid).children(recursive=True)
                process.send_signal(number)
                if rng.random() < 0.2 and number != signal.SIGKILL:
                    time.sleep(rng.uniform(0, 0.2))
                    sent.append(rng.choice(SIGNALS[:3]))
                    process.send_signal(sent[-1])
            _, err = process.communicate(timeout=SECONDS)
        _, alive = psutil.wait_procs(children, timeout=5)
        require(not alive, f"{name}, {number.name}: processes are left: {alive}")
        if number != signal.SIGKILL:
            codes = (0, 1, *(code for each in sent for code in (-each, 128 + each)))
            require(process.returncode in codes, f"{name}, {number.name}: {process.returncode}: {err}")
            lines = [line for line in err.splitlines() if not line.startswith("omniscv: compiling kernels")]
            require(len(lines) <= 1, f"{name}, {number.name}: {err}")
        if (work / "room.sqlite").exists():
            ran(["recording", "info", "room.sqlite"])
            verified = ran(["recording", "check", "room.sqlite"])
            require(verified.code == 0, f"{name}, {number.name}: {verified.out}{verified.err}")
        half = [each.name for each in work.rglob("*") if "part" in each.name and number != signal.SIGKILL]
        require(not half, f"{name}, {number.name}: half files are left: {half}")
