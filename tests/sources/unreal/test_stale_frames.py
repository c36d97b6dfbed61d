"""The detector of stale frames, by itself."""

from omniscv.sources.unreal.driver import SETTLED, StaleFrames


def test_a_frame_that_equals_the_one_before_the_move_is_rejected_until_it_differs():
    stale = StaleFrames()
    assert stale.skips() == SETTLED
    assert stale.accepts("A", {"lit": b"a"})
    assert stale.skips() == 0
    assert not stale.accepts("B", {"lit": b"a"})
    assert stale.in_doubt
    assert stale.skips() == 1
    assert stale.accepts("B", {"lit": b"b"})
    assert stale.lag == 1  # what helped once is done at every move


def test_what_stays_equal_is_a_lookalike_and_accepted_at_once_the_next_time():
    stale = StaleFrames()
    answers = [stale.accepts(state, {"depth": b"sky"}) for state in "ABBBCD"]
    assert answers == [True, False, False, True, True, True]
    assert stale.lag == 0


def test_one_fresh_mode_says_nothing_of_another():
    stale = StaleFrames()
    stale.note("A", {"lit": b"a", "depth": b"1"})
    assert stale.accepts("B", {"lit": b"b"})
    assert not stale.accepts("B", {"depth": b"1"})


def test_single_stale_frames_do_not_raise_the_lag_without_end():
    stale = StaleFrames()
    stale.note("0", {"lit": b"0"})
    for i in range(1, 10):
        assert not stale.accepts(str(i), {"lit": b"%d" % (i - 1)})
        assert stale.accepts(str(i), {"lit": b"%d" % i})
    assert stale.lag == SETTLED


def test_a_new_connection_forgets_frames_and_keeps_the_lag():
    stale = StaleFrames()
    stale.accepts("A", {"lit": b"a"})
    stale.accepts("B", {"lit": b"a"})
    stale.accepts("B", {"lit": b"b"})
    stale.reset()
    assert stale.lag == 1
    assert not stale.in_doubt
    assert stale.accepts("C", {"lit": b"b"})
