"""Feed batches of a recording's images to a placeholder for a network, and print the rate.

    omniscv record --source scene://four-wall --camera equirectangular --size 512x256 \\
        --position 0,0,1.5 --set strategy=cube --modes lit,object_mask,depth --out room.sqlite
    python examples/training/torch_batches.py room.sqlite --workers 2

Every image has its own orientation, drawn from seed, epoch and index.
"""

import argparse
import time

import torch
from torch.utils.data import DataLoader

import omniscv
import omniscv.torch

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--count", type=int, default=64, help="images of each optical centre, an epoch")
    parser.add_argument("--epochs", type=int, default=2)
    arguments = parser.parse_args()

    camera = omniscv.cameras.create("equirectangular", width=512, height=256)
    turns = omniscv.torch.RandomTurns(camera, pitch_deg=(-20, 20), roll_deg=(-5, 5))
    modes = ("lit", "object_mask", "depth")
    images = omniscv.torch.RecordingDataset(arguments.recording, turns, modes, per_center=arguments.count)
    loader = DataLoader(
        images, arguments.batch, num_workers=arguments.workers, persistent_workers=arguments.workers > 0
    )
    device = "cuda" if torch.cuda.is_available() else "cpu"
    for epoch in range(arguments.epochs):
        images.set_epoch(epoch)
        started = time.perf_counter()
        for batch in loader:
            pictures = batch["lit"].to(device).float() / 255
            labels, depth = batch["labels"].to(device), batch["depth"].to(device)
            assert (
                len(pictures) == len(labels) == len(depth)
            )  # replace this with the network's forward and backward pass
        rate = len(images) / (time.perf_counter() - started)
        print(f"epoch {epoch}: {len(images)} images of {camera.width} x {camera.height}, {rate:.1f} images/s")
