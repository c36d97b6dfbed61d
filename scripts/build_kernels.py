"""Compiles the declared kernels of omniscv and the mock server into libraries: see docs/contributing.md.

numba compiles the signatures of each kernel to LLVM's intermediate representation, in a process of its own:
what else it has compiled before decides what it puts inline, and whether a loop is vectorized. This is linked
into one module a package, with a function for C for each signature. llvmlite emits objects of it, and zig
links these for glibc 2.17. Equal sources and versions give equal bytes.
"""

import argparse
import hashlib
import importlib
import json
import multiprocessing
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

import llvmlite.binding as llvm  # noqa: E402
import numba  # noqa: E402
from numba import from_dtype, types  # noqa: E402

from mock_server.compiled import Kernel, symbol  # noqa: E402
from mock_server.signatures import ArrayType, Scalar, Signature, Type  # noqa: E402

PACKAGES = ("mock_server", "omniscv")


class Target(NamedTuple):
    """A platform: numba's processor, LLVM's names of the platform and its processor, and zig's name of it.

    Features are changes to what LLVM knows of the processor, for numba and LLVM.
    """

    numba_cpu: str
    triple: str
    cpu: str
    zig: str
    features: str = ""


TARGETS = {
    "linux-x86_64": Target("x86-64-v2", "x86_64-unknown-linux-gnu", "x86-64-v2", "x86_64-linux-gnu.2.17"),
    "linux-x86_64-v3": Target("x86-64-v3", "x86_64-unknown-linux-gnu", "x86-64-v3", "x86_64-linux-gnu.2.17"),
    "linux-x86_64-v4": Target(
        "x86-64-v4", "x86_64-unknown-linux-gnu", "x86-64-v4", "x86_64-linux-gnu.2.17", "-prefer-256-bit"
    ),
    "linux-aarch64": Target("x86-64-v2", "aarch64-unknown-linux-gnu", "generic", "aarch64-linux-gnu.2.17"),
    "darwin-arm64": Target("generic", "arm64-apple-macosx11.0.0", "apple-m1", "aarch64-macos"),
    "win32-amd64": Target("x86-64-v2", "x86_64-pc-windows-gnu", "x86-64-v2", "x86_64-windows-gnu"),
}
"""By the names of libraries. Code of a vector of two numbers for x86-64 serves ARM, too."""
COMMITTED = ("linux-x86_64", "linux-x86_64-v3", "linux-x86_64-v4", "linux-aarch64")
"""Those whose kernels were run; the workflow publish.yml builds others on their own machines."""
_DECREMENT = re.compile(
    r"(%\S+) = (?:tail )?call i8 @llvm\.x86\.atomic\.sub\.cc\S*"
    r"\(ptr (?:nonnull )?([^,]*), i64 (\d+), i32 4\)[^\n]*"
)
"""How x86 counts the users of an array down and compares with 0, which LLVM wrote into the module."""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare with the libraries that are there")
    parser.add_argument("--platform", action="append", choices=TARGETS, help="one of these, not all of Linux")
    parser.add_argument("--modules", type=Path, help=argparse.SUPPRESS)  # write them here, and nothing else
    arguments = parser.parse_args()
    if arguments.modules:
        for package in PACKAGES:
            module = module_of(declared_kernels(package))
            (arguments.modules / package).write_text(module, encoding="ascii")
        return 0
    files: dict[str, bytes] = {}
    names = arguments.platform or COMMITTED
    for cpu, features in sorted({(TARGETS[name].numba_cpu, TARGETS[name].features) for name in names}):
        modules = modules_for(cpu, features)
        for name in names:
            if TARGETS[name].numba_cpu == cpu:
                for package, module in modules.items():
                    files[f"{package}/kernels/{name}.so"] = library(module, TARGETS[name])
    for package in PACKAGES:
        files[f"{package}/kernels/table.json"] = table_of(package, files)
    differing = []
    for name, data in files.items():
        path = ROOT / name
        if not arguments.check:
            replace(path, data)
        elif not path.exists() or path.read_bytes() != data:
            differing.append(name)
        print(f"{name}: {len(data)} bytes")
    if differing:
        print(f"kernels: expected what this source and {versions()} give, got other bytes in {differing}")
    return int(bool(differing))


def modules_for(cpu: str, features: str) -> dict[str, str]:
    """Return LLVM's text of the module of each package, compiled for a processor in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {"NUMBA_CPU_NAME": cpu, "NUMBA_CPU_FEATURES": features}
        command = [sys.executable, __file__, "--modules", folder]
        subprocess.run(command, env={**os.environ, **environment}, check=True)
        return {package: Path(folder, package).read_text(encoding="ascii") for package in PACKAGES}


def table_of(package: str, files: Mapping[str, bytes]) -> bytes:
    """Return the table of a package's kernels: what they were built from, and with, and their digests."""
    libraries = {}
    for name in TARGETS:
        path = f"{package}/kernels/{name}.so"
        data = files.get(path) or ((ROOT / path).read_bytes() if (ROOT / path).exists() else b"")
        if data:
            libraries[f"{name}.so"] = hashlib.sha256(data).hexdigest()
    kernels = {kernel.full_name: described(kernel) for kernel in declared_kernels(package)}
    table = {"versions": versions(), "libraries": libraries, "changing": [], "kernels": kernels}
    return (json.dumps(table, indent=1) + "\n").encode()


def replace(path: Path, data: bytes) -> None:
    """Write a file in place of another one, which processes may be running."""
    path.parent.mkdir(exist_ok=True)
    part = path.with_suffix(".part")
    part.write_bytes(data)
    part.replace(path)


def versions() -> dict[str, str]:
    """Return what the bytes of libraries depend on beside the sources."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"python": python, **{name: version(name) for name in ("numba", "llvmlite", "ziglang")}}


def declared_kernels(package: str) -> list[Kernel]:
    """Return the kernels of a package that declare signatures, by name."""
    kernels: dict[str, Kernel] = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        if not re.search(r"^@njit\(", path.read_text(), re.MULTILINE):
            continue
        module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
        for value in vars(module).values():
            if isinstance(value, Kernel) and value.declared:
                kernels[value.full_name] = value
    return [kernels[name] for name in sorted(kernels)]


def described(kernel: Kernel) -> dict[str, Any]:
    """Return the entry of a kernel in the table."""
    return {"digest": kernel.digest, "signatures": list(kernel.declared)}


def module_of(kernels: list[Kernel]) -> str:
    """Return LLVM's text of a module with a C function for each signature of kernels."""
    module = llvm.parse_assembly("")
    names = []
    with multiprocessing.Pool(maxtasksperchild=1) as processes:
        texts = processes.map(texts_of, [kernel.full_name for kernel in kernels], chunksize=1)
    for kernel, of_signatures in zip(kernels, texts, strict=True):
        for index, text in enumerate(of_signatures):
            module.link_in(llvm.parse_assembly(text))
            names.append(symbol(kernel.full_name, index))
    for function in module.functions:
        if not function.is_declaration and function.name not in names:
            function.linkage = "internal"
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    remove_unused(module)
    module.verify()
    return str(module)


def texts_of(full_name: str) -> list[str]:
    """Return LLVM's text of each signature of a kernel; in a process that has compiled nothing else."""
    module_name, _, name = full_name.rpartition(".")
    kernel = getattr(importlib.import_module(module_name), name)
    texts = []
    with tempfile.TemporaryDirectory() as folder:
        numba.config.CACHE_DIR = folder  # numba keeps no text beside what it has kept
        for index, signature in enumerate(kernel.signatures):
            texts.append(compiled(kernel, signature, symbol(full_name, index)))
    return texts


def compiled(kernel: Kernel, signature: Signature, name: str) -> str:
    """Return LLVM's text of a kernel for a signature, and of the function ``name``, which calls it."""
    arguments = tuple(numba_type(item) for item in signature.arguments.items)
    dispatcher = kernel.dispatcher
    dispatcher.compile(arguments)
    compiled_for = dispatcher.overloads[arguments]
    returned = types.none if signature.returns is None else numba_type(signature.returns)
    if compiled_for.signature.return_type != returned:
        raise SystemExit(
            f"{kernel.full_name}: declared to return {returned}, got {compiled_for.signature.return_type}"
        )
    text = dispatcher.inspect_llvm(arguments)
    module = llvm.parse_assembly(text)
    function = module.get_function(compiled_for.fndesc.llvm_func_name)
    loads = []
    values = []
    for word, argument in enumerate(list(function.arguments)[2:]):
        loads.append(f"  %p{word} = getelementptr i8, ptr %buffer, i64 {8 + 8 * word}")
        loads.append(f"  %a{word} = load {argument.type}, ptr %p{word}")
        values.append(f"{argument.type} %a{word}")
    if 8 + 8 * len(values) != signature.result_at:
        raise SystemExit(
            f"{kernel.full_name}: declared {signature.result_at // 8 - 1} words, got {len(values)}"
        )
    given = ", ".join(["ptr %result", "ptr %buffer", *values])
    body = "\n".join(loads)
    return f"""{text}
define i32 @{name}(ptr %buffer) {{
  %result = getelementptr i8, ptr %buffer, i64 {signature.result_at}
{body}
  %status = call i32 @"{function.name}"({given})
  ret i32 %status
}}
"""


def numba_type(type_: Type) -> Any:
    """Return numba's type of a declared one."""
    if isinstance(type_, Scalar):
        return types.boolean if type_.name == "bool" else getattr(types, type_.name)
    if isinstance(type_, ArrayType):
        layout = "C" if type_.contiguous else "A"
        return types.Array(from_dtype(type_.dtype), type_.ndim, layout, readonly=not type_.out)
    items = tuple(numba_type(item) for item in type_.items)
    return types.NamedTuple(items, type_.cls) if type_.cls else types.Tuple(items)


def remove_unused(module: Any) -> None:
    """Remove functions that no exported one calls, such as wrappers for Python."""
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine()
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=0))
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, builder)


def library(assembly: str, target: Target) -> bytes:
    """Return the shared library of a module for a platform."""
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu, features=target.features, opt=3, reloc="pic", codemodel="default"
    )
    text = re.sub(r'target triple = ".*"', f'target triple = "{target.triple}"', assembly)
    text = re.sub(r'target datalayout = ".*"', f'target datalayout = "{machine.target_data}"', text)
    text = re.sub(r'"(target-features|target-cpu)"="[^"]*"', "", text)
    numbers = count()
    text = _DECREMENT.sub(lambda match: _decrement(match, next(numbers)), text)
    with tempfile.TemporaryDirectory() as folder:
        kernels = Path(folder, "kernels.o")
        kernels.write_bytes(machine.emit_object(llvm.parse_assembly(text)))
        runtime = Path(folder, "runtime.c")
        runtime.write_bytes((ROOT / "scripts" / "kernel_runtime.c").read_bytes())
        zig = [sys.executable, "-m", "ziglang", "cc", "-target", target.zig, "-O2", "-shared", "-s"]
        of_linux = ["-Wl,-z,defs", "-lm"] if "linux" in target.zig else []
        command = [*zig, "-o", "library", runtime.name, kernels.name, *of_linux]
        subprocess.run(command, cwd=folder, check=True)
        return Path(folder, "library").read_bytes()


def _decrement(match: re.Match[str], number: int) -> str:
    """Return what every processor understands for one of ``_DECREMENT``."""
    result, pointer, step = match.groups()
    before = f"%before{number}"
    return (
        f"{before} = atomicrmw sub ptr {pointer}, i64 {step} monotonic\n"
        f"  %is{number} = icmp eq i64 {before}, {step}\n"
        f"  {result} = zext i1 %is{number} to i8"
    )


if __name__ == "__main__":
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    sys.exit(main())
