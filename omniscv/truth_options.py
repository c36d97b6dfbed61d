"""Options of truths that are keys of jobs, too; light to import."""

from functools import partial
from typing import Literal, get_args

from omniscv.arguments import number, one_of
from omniscv.records import checked, nested, record

LayoutSource = Literal["scene", "fitted"]
Visibility = Literal["room", "full", "all"]

layout_source = partial(one_of, words=get_args(LayoutSource))
_sigma = partial(number, above=0, most=1)


@record
class Tolerance:
    """How far two depths along a ray may differ and still be taken for one; the larger of both limits counts.

    It is the key ``tolerance`` under a job's ``truth:``.
    """

    abs_m: float = checked(number, least=0, default=0.02, help="metres within which depths are equal")
    rel: float = checked(number, least=0, default=0.01, help="the same, as a share of the depth")


@record
class MapOptions:
    """How maps of edges and corners are drawn; see :func:`omniscv.truth.layout_labels.exact_maps`."""

    edge_sigma: float | None = checked(
        _sigma, default=None, help="width of edges, a share of a full turn; default 0.0054"
    )
    corner_sigma: float | None = checked(
        _sigma, default=None, help="width of corners, a share of a full turn; default 0.0107"
    )
    visibility: Visibility | None = checked(
        one_of,
        words=get_args(Visibility),
        default=None,
        help="room (default): not hidden by walls; full: not hidden by anything; all",
    )


@record
class LayoutKey:
    """The key ``layout`` of a job: of the truth ``layout``, and of the formats that draw its maps."""

    source: LayoutSource | None = checked(layout_source, default=None, help="scene or fitted")
    maps: MapOptions = checked(nested(MapOptions), default=MapOptions(), help="how maps are drawn")
