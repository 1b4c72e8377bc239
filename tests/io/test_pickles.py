import pickle
from collections import OrderedDict

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sg3d_jax.io import pickles
from sg3d_jax.io.pickles import Asked, Name, read_pickle

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


def read(data, *admitted):
    return read_pickle(data, {Name(*name) for name in admitted}, "a.pkl", "data")


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
    asked = read(
        pickle.dumps(error, protocol), ("builtins", "ValueError"), ("exceptions", "ValueError")
    )
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


@pytest.mark.parametrize(
    "data",
    [
        b"(" + b"}" * 500 + b"t.",
        b"(" * 5000 + b".",
        b"]" + b"]a" * 500 + b".",
        b"]q\x00" + b"h\x00a" * 5000 + b".",
        b"}" + b"K\x01Ns" + b"}" * 500 + b".",
        b"\x80\x04N" + b"\x94" * 5000 + b".",
        b"G" + b"0" * 8 + b"(" + (b"G" + b"0" * 8) * 1000 + b"l.",
    ],
)
def test_what_fills_the_memory_is_refused(data):
    with pytest.raises(ValueError, match=r"a\.pkl: the pickle describes more than fits into mem"):
        read_pickle(data, frozenset(), "a.pkl", "data", most=len(data) + 20_000)


def test_a_stack_higher_than_picklers_make_it_is_refused(monkeypatch):
    monkeypatch.setattr(pickles, "MAX_STACK", 100)
    with pytest.raises(ValueError, match=r"a\.pkl: the pickle has more than 100 values on its st"):
        read(b"N" + b"2" * 100 + b".")


@settings(deadline=None, max_examples=200)
@given(data=st.binary(max_size=40))
def test_any_bytes_are_refused_or_read(data):
    refusal = None
    try:
        read(data)
    except ValueError as error:
        refusal = str(error)
    assert refusal is None or (refusal.startswith("a.pkl: the ") and "\n" not in refusal)
