"""The formats that datasets are exported to; :mod:`omniscv.dataset.exporting` lists their modules."""
