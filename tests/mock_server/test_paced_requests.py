"""Requests of servers whose frames last as long as an engine's."""

import queue

import pytest

from mock_server.engine import PacedRequests


def test_a_frame_answers_what_came_before_it_in_order():
    requests = PacedRequests(frame_s=1e-3, latency_s=0.0)
    for payload in (b"1", b"2"):
        assert requests.put(payload)
    requests.end()
    _, first = requests.get(1e-3)
    assert first == b"1"
    assert requests.get(0)[1] == b"2"
    assert requests.get(0) is None
    with pytest.raises(queue.Empty):
        requests.get(1e-3)


def test_a_request_comes_into_sight_when_its_latency_is_over():
    requests = PacedRequests(frame_s=1e-3, latency_s=3600.0)
    requests.put(b"1")
    for wait_s in (1e-3, 0):
        with pytest.raises(queue.Empty):
            requests.get(wait_s)


def test_requests_sent_together_share_a_frame(start, open_raw):
    """So a pose set by one is not yet the player's camera's in the next; it is two frames later."""
    client = open_raw(start(dialect="N1", paced=True, frames_per_s=5, size=(8, 8)))
    client.send(b"1:vset /camera/0/location 50 0 150", b"2:vget /camera/0/location")
    assert [client.frame(), client.frame()] == [b"1:ok", b"2:0.000 0.000 150.000"]
    readings = [client.ask(b"vget /camera/0/location") for _ in range(2)]
    assert readings == [b"0.000 0.000 150.000", b"50.000 0.000 150.000"]
