"""Camera models by name: those of this package and of other packages that register theirs."""

import inspect
from collections.abc import Mapping
from typing import Any, TypeVar

from omniscv import plugins
from omniscv.arguments import one_of, shown
from omniscv.cameras.base import Camera, Parameter
from omniscv.errors import ArgumentError

C = TypeVar("C", bound=Camera)

_MODELS: dict[str, type[Camera]] = {}


def register(cls: type[C]) -> type[C]:
    """Add a camera model under its ``name``, and return the class; usable as a decorator.

    Raises ArgumentError for what is no subclass of :class:`Camera`, or an abstract one, and for a missing or
    taken name.
    """
    if not (isinstance(cls, type) and issubclass(cls, Camera)):
        raise ArgumentError(f"camera model: expected a subclass of omniscv.cameras.Camera, got {shown(cls)}")
    name = getattr(cls, "name", None)
    if not isinstance(name, str) or not name:
        raise ArgumentError(f"{cls.__name__}.name: expected the model's name, got {shown(name)}")
    if inspect.isabstract(cls):
        missing = ", ".join(sorted(cls.__abstractmethods__))
        raise ArgumentError(f"{cls.__name__}: expected a class that implements {missing}, got one without")
    if _MODELS.setdefault(name, cls) is not cls:
        other = f"{name!r} of {_MODELS[name].__module__}.{_MODELS[name].__qualname__}"
        raise ArgumentError(f"{cls.__name__}.name: expected a name that no other model has, got {other}")
    return cls


def names() -> list[str]:
    """Return the names of all models, in the order of their registration."""
    plugins.load()
    return list(_MODELS)


def model(name: str) -> type[Camera]:
    """Return the class of a model; ArgumentError if no model has that name."""
    known = isinstance(name, str) and name in _MODELS
    return _MODELS[name if known else one_of("camera", name, names())]


def create(
    name: str, /, width: int | None = None, height: int | None = None, **parameters: Parameter
) -> Camera:
    """Return a camera.

    Args:
        name: of its model.
        width: of the image, px; only ``lidar`` has one of its own where none is given.
        height: of the image, px, likewise.
        parameters: the model's own.

    Raises:
        ArgumentError: an unknown name, or a parameter that the model does not take, lacks or refuses.
    """
    arguments: dict[str, Any] = {}
    if width is not None:
        arguments["width"] = width
    if height is not None:
        arguments["height"] = height
    return _construct(name, arguments | parameters)


def from_dict(data: Mapping[str, Any]) -> Camera:
    """Return the camera that ``camera.to_dict()`` described.

    Raises:
        ArgumentError: no ``model`` in it, or as :func:`create`.
    """
    if not isinstance(data, Mapping) or "model" not in data:
        raise ArgumentError(f"camera: expected a mapping with 'model' in it, got {shown(data)}")
    arguments = dict(data)
    name = arguments.pop("model")
    return _construct(name, arguments)


def _construct(name: str, arguments: Mapping[str, Any]) -> Camera:
    """Return the camera of a model; ArgumentError names parameters that are missing or unknown."""
    cls = model(name)
    signature = inspect.signature(cls)
    try:
        signature.bind(**arguments)
    except TypeError:
        raise ArgumentError(_other_parameters(name, signature, arguments)) from None
    return cls(**arguments)


def _other_parameters(name: str, signature: inspect.Signature, arguments: Mapping[str, Any]) -> str:
    """Return the message for arguments that a model does not take, or that it lacks."""
    needed = []
    optional = []
    problems = []
    for key, parameter in signature.parameters.items():
        if parameter.default is not parameter.empty:
            optional.append(key)
            continue
        needed.append(key)
        if key not in arguments:
            problems.append(f"no {key}")
    problems += [shown(key) for key in arguments if key not in signature.parameters]
    expected = " and optionally ".join(", ".join(keys) for keys in (needed, optional) if keys)
    advice = f"'omniscv cameras {name}' has an example"
    return f"camera {name}: expected {expected}; got {', '.join(problems)}; {advice}"
