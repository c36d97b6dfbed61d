"""Published protocols give the figures that their authors' own code gave on the same arrays."""

import numpy as np
import pytest
from support.published_scores import FIGURES, images

from omniscv.errors import ArgumentError
from omniscv.score.protocols import PROTOCOLS, protocol


@pytest.mark.parametrize("name", PROTOCOLS)
def test_figures_are_those_of_the_authors_code(name):
    rows = []
    for p, t, valid in images():
        predicted = 0.7 / p + 0.05 if PROTOCOLS[name].form == "disparity" else p
        rows.append(protocol(name, predicted, t, valid))
    assert set(rows[0]) == set(FIGURES[name])
    for measure, expected in FIGURES[name].items():
        assert np.mean([row[measure] for row in rows]) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_what_no_protocol_can_score_is_refused():
    p, t, valid = next(images())
    with pytest.raises(ArgumentError, match="protocol: expected"):
        protocol("best", p, t, valid)
    with pytest.raises(ArgumentError, match="expected a pixel that counts"):
        protocol("moge", p, t, valid & False)
