"""Compiles the declared kernels of omniscv and the mock server into libraries: see docs/contributing.md.

numba compiles each signature to LLVM's intermediate representation. This is linked into one module a
package, with a function for C for each signature. llvmlite emits objects of it, and zig links these for glibc
2.17. Equal sources and versions give equal bytes.
"""

import argparse
import importlib
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

# Before numba is imported: code for any processor of the last decade, and nothing kept from other runs.
CPU = "x86-64-v2" if platform.machine().lower() in ("x86_64", "amd64") else "generic"
os.environ.update(NUMBA_CPU_NAME=CPU, NUMBA_CPU_FEATURES="", NUMBA_CACHE_DIR=tempfile.mkdtemp())

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

import llvmlite.binding as llvm  # noqa: E402
from numba import from_dtype, types  # noqa: E402

from mock_server.compiled import Kernel, symbol  # noqa: E402
from mock_server.signatures import ArrayType, Scalar, Signature, Type  # noqa: E402

PACKAGES = ("mock_server", "omniscv")
TARGETS = {
    "linux-x86_64.so": ("x86_64-unknown-linux-gnu", "x86-64-v2", "x86_64-linux-gnu.2.17"),
    "linux-aarch64.so": ("aarch64-unknown-linux-gnu", "generic", "aarch64-linux-gnu.2.17"),
    "darwin-arm64.so": ("arm64-apple-macosx11.0.0", "apple-m1", "aarch64-macos"),
    "win32-amd64.so": ("x86_64-pc-windows-gnu", "x86-64-v2", "x86_64-windows-gnu"),
}
"""Libraries: LLVM's name of the platform, the processor, and zig's name of the platform."""
COMMITTED = ("linux-x86_64", "linux-aarch64")
"""The platforms on which kernels were run; the workflow publish.yml builds others on their own machines."""
_DECREMENT = re.compile(
    r"(%\S+) = (?:tail )?call i8 @llvm\.x86\.atomic\.sub\.cc\S*"
    r"\(ptr (?:nonnull )?([^,]*), i64 (\d+), i32 4\)[^\n]*"
)
"""How x86 counts the users of an array down and compares with 0, which LLVM wrote into the module."""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare with the libraries that are there")
    platforms = [name.removesuffix(".so") for name in TARGETS]
    parser.add_argument(
        "--platform", action="append", choices=platforms, help="one of these, not all of Linux"
    )
    arguments = parser.parse_args()
    check = arguments.check
    differing = []
    for package in PACKAGES:
        kernels = declared_kernels(package)
        table = {
            "versions": versions(),
            "changing": [],
            "kernels": {kernel.full_name: described(kernel) for kernel in kernels},
        }
        folder = ROOT / package / "kernels"
        folder.mkdir(exist_ok=True)
        assembly = module_of(kernels)
        files = {"table.json": (json.dumps(table, indent=1) + "\n").encode()}
        for name in arguments.platform or COMMITTED:
            files[f"{name}.so"] = library(assembly, f"{name}.so")
        for name, data in files.items():
            path = folder / name
            if check and (not path.exists() or path.read_bytes() != data):
                differing.append(f"{package}/kernels/{name}")
            if not check:
                replace(path, data)
            print(f"{package}/kernels/{name}: {len(kernels)} kernels, {len(data)} bytes")
    if differing:
        print(f"kernels: expected what this source and {versions()} give, got other bytes in {differing}")
    return int(bool(differing))


def replace(path: Path, data: bytes) -> None:
    """Write a file in place of another one, which processes may be running."""
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
    for kernel in kernels:
        for index, signature in enumerate(kernel.signatures):
            name = symbol(kernel.full_name, index)
            module.link_in(llvm.parse_assembly(compiled(kernel, signature, name)))
            names.append(name)
    for function in module.functions:
        if not function.is_declaration and function.name not in names:
            function.linkage = "internal"
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    remove_unused(module)
    module.verify()
    return str(module)


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


def library(assembly: str, name: str) -> bytes:
    """Return the shared library of a module for one of the TARGETS."""
    triple, processor, platform_ = TARGETS[name]
    target = llvm.Target.from_triple(triple)
    machine = target.create_target_machine(cpu=processor, opt=3, reloc="pic", codemodel="default")
    text = re.sub(r'target triple = ".*"', f'target triple = "{triple}"', assembly)
    text = re.sub(r'target datalayout = ".*"', f'target datalayout = "{machine.target_data}"', text)
    text = re.sub(r'"(target-features|target-cpu)"="[^"]*"', "", text)
    counter = iter(range(len(text)))
    text = _DECREMENT.sub(lambda match: _decrement(match, next(counter)), text)
    with tempfile.TemporaryDirectory() as folder:
        kernels = Path(folder, "kernels.o")
        kernels.write_bytes(machine.emit_object(llvm.parse_assembly(text)))
        runtime = Path(folder, "runtime.c")
        runtime.write_bytes((ROOT / "scripts" / "kernel_runtime.c").read_bytes())
        zig = [sys.executable, "-m", "ziglang", "cc", "-target", platform_, "-O2", "-shared", "-s"]
        strict = ["-Wl,-z,defs"] if "linux" in platform_ else []
        linked = [*strict, "-o", name, runtime.name, kernels.name, *(["-lm"] if "linux" in platform_ else [])]
        subprocess.run([*zig, *linked], cwd=folder, check=True)
        return Path(folder, name).read_bytes()


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
