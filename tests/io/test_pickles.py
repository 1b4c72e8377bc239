import gc
import pickle
import struct
from collections import OrderedDict

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.io import memory, pickle_words
from sg3d_jax.io.pickle_words import Asked, Name
from sg3d_jax.io.pickles import read_pickle

PROTOCOLS = st.integers(0, pickle.HIGHEST_PROTOCOL)
ATOMS = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False)
KEYS = ATOMS | st.text()
DATA = st.recursive(
    KEYS,
    lambda inner: (
        st.lists(inner) | st.lists(inner).map(tuple) | st.dictionaries(KEYS, inner, max_size=4)
    ),
    max_leaves=30,
)


FULL = r"a\.pkl: the pickle describes more than fits into memory"
ERROR = ("builtins", "ValueError"), ("exceptions", "ValueError")


def read(data, *admitted, **options):
    return read_pickle(data, {Name(*name) for name in admitted}, "a.pkl", "data", **options)


@pytest.fixture
def _no_collection(monkeypatch, _unchecked):
    """Looking for unreachable loops takes long in a process that has as much in it as this one."""
    monkeypatch.setattr(gc, "collect", lambda: 0)


@settings(deadline=None, max_examples=100)
@given(value=DATA, protocol=PROTOCOLS)
def test_plain_data_are_read_as_python_reads_them(value, protocol):
    found = read(pickle.dumps(value, protocol))
    assert found == value
    assert repr(found) == repr(value)  # 1 == 1.0 == True


@settings(deadline=None)
@given(value=st.binary(), protocol=st.integers(3, pickle.HIGHEST_PROTOCOL))
def test_bytes_are_read_as_python_reads_them(value, protocol):
    assert read(pickle.dumps(value, protocol)) == value


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_what_is_shared_or_endless_stays_so(protocol):
    shared = [0.5]
    value = [shared, (shared, {"a": shared})]
    value.append(value)
    value.append((value,))
    found = read(pickle.dumps(value, protocol))
    assert found[0] is found[1][0] is found[1][1]["a"]
    assert found[2] is found is found[3][0]


@pytest.mark.parametrize("protocol", [4, 5])
def test_sets_are_read_as_lists(protocol):
    found = read(pickle.dumps([{1, 2}, frozenset({3})], protocol))
    assert sorted(found[0]) == [1, 2]
    assert found[1] == [3]


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_an_object_is_written_down_and_not_made(protocol):
    data = pickle.dumps([complex(1, 2)], protocol)
    admitted = {("builtins", "complex"), ("__builtin__", "complex")}
    (asked,) = read(data, *admitted)
    assert type(asked) is Asked
    assert asked.name in {Name(*name) for name in admitted}
    assert asked.arguments == (1.0, 2.0)
    assert asked.state is None


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_the_state_of_an_object_is_written_down(protocol):
    error = ValueError("no")
    error.place = 7
    asked = read(pickle.dumps(error, protocol), *ERROR)
    assert asked.arguments == ("no",)
    assert asked.state == {"place": 7}


def test_a_name_that_is_not_admitted_is_refused():
    data = pickle.dumps(OrderedDict())
    assert type(read(data, ("collections", "OrderedDict"))) is Asked
    with pytest.raises(
        ValueError, match=r"^a.pkl: the pickle asks for collections.OrderedDict, exp"
    ):
        read(data, ("collections", "Ordered"), ("collection", "OrderedDict"))


def test_what_follows_the_pickle_is_refused():
    with pytest.raises(
        ValueError, match=r"^a.pkl: the file goes on after the pickle, expected data$"
    ):
        read(pickle.dumps(1) + b"\n")


@pytest.mark.usefixtures("_no_collection")
@pytest.mark.parametrize(
    "data",
    [
        b"(" + b"}" * 500 + b"t.",
        b"]" + b"]a" * 500 + b".",
        b"]q\x00" + b"h\x00a" * 5000 + b".",
        b"}" + b"K\x01Ns" + b"}" * 500 + b".",
        b"\x80\x04N" + b"\x94" * 50_000 + b".",
        b"\x80\x04(N" + b"\x94" * 200 + b"".join(b"h" + bytes([i]) for i in range(200)) + b"t.",
        b"G" + b"0" * 8 + b"(" + (b"G" + b"0" * 8) * 1000 + b"l.",
    ],
)
def test_what_fills_the_memory_is_refused(data):
    with pytest.raises(ValueError, match=FULL):
        read(data, most=len(data) + 20_000)


def things(count, shared=()):
    """Returns objects with a state of some kilobytes each, all with what they share."""
    made = [ValueError(number) for number in range(count)]
    for number, error in enumerate(made):
        error.numbers = [number + place / 128 for place in range(100)]
        error.shared = shared
    return made


@pytest.mark.usefixtures("_no_collection")
@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_only_what_is_made_of_an_object_stays(protocol):
    def made(asked):
        return (sum(asked.state["numbers"]), asked.state["shared"]["a"]), 200

    errors = things(120, {"a": [0.5, "b"]})
    data = pickle.dumps(errors, protocol)
    most = len(data) + 200_000
    with pytest.raises(ValueError, match=FULL):
        read(data, *ERROR, most=most)
    found = read(data, *ERROR, most=most, made=made)
    assert [asked.state[0] for asked in found] == [sum(error.numbers) for error in errors]
    assert all(asked.state[1] == [0.5, "b"] for asked in found)
    with pytest.raises(ValueError, match=FULL):
        read(data, *ERROR, most=most, made=lambda asked: (made(asked)[0], 2000))


def long(count):
    return b"(" + b"G1234567" + b"8" + (b"G12345678" * (count - 1)) + b"l"


SINK = b"]\x94"  # a list, the first of the memo
MANY = 200


@pytest.mark.usefixtures("_no_collection")
@pytest.mark.parametrize(
    "data",
    [
        SINK + (b"h\x00" + long(100) + b"a0") * MANY,
        SINK + b"0" + (b"h\x00" + long(100) + b"a0") * MANY + b"h\x00",
        b"}\x94" + b"".join(b"h\x00K" + bytes([i]) + long(100) + b"s0" for i in range(MANY)),
        b"("
        + (long(100) + b"\x940") * MANY
        + b"".join(b"h" + bytes([i]) for i in range(MANY))
        + b"l",
        b"N" + long(100) * MANY + b"0" * MANY,
    ],
    ids=["in a list", "in the memo alone", "in a dict", "each in the memo", "on the stack"],
)
def test_what_is_still_in_use_is_not_given_back(data):
    assert len(data) < 2**18
    with pytest.raises(ValueError, match=FULL):
        read(data + b".", most=len(data) * 2 + 50_000)
    read(data + b".")


@pytest.mark.usefixtures("_no_collection")
def test_what_is_dropped_is_given_back():
    data = b"]" + (long(100) + b"0") * MANY + b"."
    assert read(data, most=len(data) + 50_000) == []


@pytest.mark.usefixtures("_unchecked")
def test_what_refers_to_itself_is_given_back_too():
    loops = b"".join(
        b"]r" + i + b"j" + i + b"a0" for i in map(struct.Struct("<I").pack, range(9999))
    )
    gc.disable()
    gc.freeze()  # nothing that is there already is looked at
    try:
        read(loops + b"N.", most=10 * len(loops))
        assert len(gc.get_objects()) < 2000
    finally:
        gc.unfreeze()
        gc.enable()


@pytest.mark.usefixtures("_no_collection")
def test_memory_that_is_given_back_is_used_for_blocks_of_the_same_size_alone():
    def phase(word, count):
        return (b"(" + word * count + b"l0" + b"N0" * 3000) * 3

    dicts, tuples = phase(b"}", 3000), phase(b"(NNNNNNNNNNt", 1500)  # some 200,000 bytes each
    most = 300_000
    for words in (dicts, tuples):
        assert read(b"N" + words + b".", most=len(words) + most) is None
    words = dicts + tuples
    with pytest.raises(ValueError, match=FULL):
        read(b"N" + words + b".", most=len(words) + most)


@pytest.mark.usefixtures("_no_collection")
def test_where_too_much_is_in_use_nothing_is_given_back(monkeypatch):
    data = b"(" + b"N" * 300 + (long(100) + b"0") * MANY + b"l."
    assert read(data, most=len(data) + 50_000) == [None] * 300
    monkeypatch.setattr(memory, "MAX_WEIGHED", 250)
    with pytest.raises(ValueError, match=FULL):
        read(data, most=len(data) + 50_000)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("times", [1, 254, 255, 256, 257, 600])
def test_what_is_recalled_often_is_there_every_time(times, protocol):
    shared = [0.5]
    found = read(pickle.dumps([[shared] * (times + 1), [1.5], shared], protocol))
    assert found == [[shared] * (times + 1), [1.5], shared]
    assert all(item is found[2] for item in found[0])


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (pickle.dumps("a" * 200, 2), "value of 200 bytes"),
        (pickle.dumps("a" * 200, 4), "value of 200 bytes"),
        (pickle.dumps(b"a" * 300, 5), "value of 300 bytes"),
        (pickle.dumps(bytearray(300), 5), "value of 300 bytes"),
        (pickle.dumps(2**4000, 2), "value of 501 bytes"),
        (pickle.dumps("a" * 200, 0), "line of more than 100 bytes"),
        (b"c" + b"a" * 200 + b"\nb\n.", "line of more than 100 bytes"),
    ],
)
def test_a_value_too_large_is_refused_unread(data, what, monkeypatch):
    monkeypatch.setattr(pickle_words, "MAX_VALUE", 100)
    with pytest.raises(ValueError, match=rf"a\.pkl: the pickle holds a {what}, expected"):
        read(data)


def test_a_stack_higher_than_picklers_make_it_is_refused(monkeypatch):
    monkeypatch.setattr(pickle_words, "MAX_STACK", 100)
    with pytest.raises(ValueError, match=r"a\.pkl: the pickle has more than 100 values on its st"):
        read(b"N" + b"2" * 100 + b".")
    with pytest.raises(ValueError, match=r"a\.pkl: the pickle has more than 100 marks on its sta"):
        read(b"N" + b"(" * 101 + b".")


@settings(deadline=None, max_examples=200)
@given(data=st.binary(max_size=40))
def test_any_bytes_are_refused_or_read(data):
    refusal = None
    try:
        read(data)
    except ValueError as error:
        refusal = str(error)
    assert refusal is None or (refusal.startswith("a.pkl: the ") and "\n" not in refusal)
