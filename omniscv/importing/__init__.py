"""Pictures of others become recordings.

:mod:`~omniscv.importing.importing` reads a folder of pictures in a layout, or a file that lists them with
their poses; :mod:`~omniscv.importing.folders` reads and writes folders in the project's own form. Where a
file leaves conventions open, the pictures themselves are asked (:mod:`~omniscv.importing.asking`). Nothing
below this package imports it: a recording knows nothing of how its captures came.
"""
