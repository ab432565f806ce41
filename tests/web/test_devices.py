"""Pairing, tokens at rest, and how often one may try. The times are given."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.files.instance import DEFAULT_NAME
from failstop.web import devices
from failstop.web.devices import ALPHABET, CODE_S, MOST, TRIES, Device, Devices, NotPaired, Pairing
from failstop.web.handlers import Guarded
from failstop.web.limits import MOST_KEYS, Limit

CODE = "AB12-CD34"


def device(token: str, identity: str = "1") -> Device:
    return Device(identity, "Anna's phone", devices.digest_of(token), 1.0)


def offered() -> Pairing:
    pairing = Pairing()
    pairing.offer(CODE, 100.0)
    return pairing


@given(st.binary(min_size=5, max_size=5))
def test_a_code_is_what_a_person_can_type(data: bytes) -> None:
    code = devices.code_of(data)
    assert len(code) == 9
    assert set(code) <= {*ALPHABET, "-"}
    assert devices.typed(f" {code.lower()} ".replace("0", "o").replace("1", "l")) == code.replace("-", "")


def test_different_bytes_are_different_codes() -> None:
    assert len({devices.code_of(number.to_bytes(5, "big")) for number in range(2000)}) == 2000


def test_a_code_pairs_once() -> None:
    pairing = offered()
    pairing.redeem("ab12 cd34", 100.0)
    with pytest.raises(NotPaired, match="no code is valid now"):
        pairing.redeem(CODE, 100.0)


def test_a_code_ends_after_two_minutes() -> None:
    offered().redeem(CODE, 100.0 + CODE_S)
    with pytest.raises(NotPaired, match="no code is valid now"):
        offered().redeem(CODE, 100.1 + CODE_S)


def test_guessing_ends_the_offer() -> None:
    pairing = offered()
    for _ in range(TRIES):
        with pytest.raises(NotPaired, match="wrong code"):
            pairing.redeem("AB12-CD35", 100.0)
    with pytest.raises(NotPaired, match="no code is valid now"):
        pairing.redeem(CODE, 100.0)


@pytest.mark.parametrize("code", ["", "-", " ", "\udcff", "AB12-CD3", "AB12-CD344"])
def test_nothing_is_no_code(code: str) -> None:
    for pairing in (Pairing(), offered()):
        with pytest.raises(NotPaired):
            pairing.redeem(code, 100.0)


def test_a_new_offer_ends_the_old_one() -> None:
    pairing = offered()
    pairing.offer("0000-0000", 100.0)
    with pytest.raises(NotPaired):
        pairing.redeem(CODE, 100.0)
    pairing.redeem("OOOO-OOOO", 100.0)


def test_what_is_kept_is_of_no_use_to_a_reader() -> None:
    token = "a" * 43
    known = Devices((device(token),))
    kept = known.dump()
    assert token.encode() not in kept
    again = Devices.load(kept)
    assert again.all() == known.all()
    assert again.of(token) == device(token)
    assert again.of(device(token).digest) is None, "the hash is no token"


def test_a_revoked_device_is_nobody() -> None:
    known = Devices((device("one"), device("two", "2")))
    assert known.revoke("1") == device("one")
    assert known.of("one") is None
    assert known.of("two") == device("two", "2")
    assert known.revoke("1") is None
    assert known.of("") is None


def test_there_is_an_end_to_them() -> None:
    known = Devices()
    for number in range(MOST):
        known.add(device(str(number), str(number)))
    with pytest.raises(NotPaired, match="revoke one"):
        known.add(device("one more"))


def test_no_two_devices_have_one_name() -> None:
    known = Devices()
    for number in range(4):
        known.add(Device(str(number), known.free_name("Anna's phone"), str(number), 1.0))
    assert [each.name for each in known.all()] == ["Anna's phone", "Anna's phone 2", "Anna's phone 3", "Anna's phone 4"]
    long = "x" * 40
    known.add(Device("5", known.free_name(long), "5", 1.0))
    assert known.free_name(long) == "x" * 28 + " 2"


@pytest.mark.parametrize("data", [b"", b"{", b"[1]", b"[{}]", b"{}x", b'[{"id": 1}]', b"7"])
def test_a_damaged_list_lets_nobody_in(data: bytes) -> None:
    with pytest.raises(ValueError, match="it is not a list of devices"):
        Devices.load(data)


@given(st.text(max_size=100))
def test_a_name_is_safe_to_show(name: str) -> None:
    found = devices.clean(name)
    assert 0 < len(found) <= devices.LONGEST_NAME
    assert found.isprintable()


def test_a_limit_gives_at_once_then_slowly() -> None:
    limit = Limit(0.5, 3)
    assert [limit.spend("a", 10.0) for _ in range(4)] == [True, True, True, False]
    assert limit.spend("b", 10.0), "everybody has their own"
    assert not limit.spend("a", 11.9)
    assert limit.spend("a", 12.0)
    assert not limit.spend("a", 5.0), "a clock that goes back gives nothing"


def test_what_is_given_back_can_be_taken_again_and_no_more() -> None:
    limit = Limit(0.001, 2)
    limit.give_back("a")
    assert [limit.spend("a", 1.0) for _ in range(3)] == [True, True, False]
    limit.give_back("a")
    assert [limit.spend("a", 1.0) for _ in range(2)] == [True, False]
    for _ in range(5):
        limit.give_back("a")
    assert [limit.spend("a", 1.0) for _ in range(3)] == [True, True, False], "never more than the burst"


def test_names_that_are_made_up_take_no_memory() -> None:
    limit = Limit(0.001, 1)
    for number in range(3 * MOST_KEYS):
        assert limit.spend(str(number), 1.0)
    assert len(limit._left) <= MOST_KEYS


@given(st.lists(st.floats(0, 3), max_size=60), st.integers(1, 5))
def test_never_more_than_the_burst_and_the_rate(steps: list[float], burst: int) -> None:
    limit = Limit(1.0, burst)
    now, given_out = 0.0, 0
    for step in steps:
        now += step
        given_out += limit.spend("a", now)
    assert given_out <= burst + now + 1e-6


def test_each_service_of_a_computer_has_its_own_cookie() -> None:
    """A browser sends the cookies of one page to the other, because it ignores the port."""
    handler = Guarded.__new__(Guarded)
    names = set()
    for scheme, name in itertools.product(("http", "https"), (DEFAULT_NAME, "left", "right")):
        handler.page = SimpleNamespace(name=name, scheme=scheme)  # type: ignore[assignment]
        assert handler.cookie.startswith("__Host-") == (scheme == "https")
        names.add(handler.cookie)
    assert len(names) == 6
    assert "failstop" in names
