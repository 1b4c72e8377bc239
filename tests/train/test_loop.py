import dataclasses
import json
import re
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import numpy.testing as npt
import optax
import pytest

from sg3d_jax.flagg.placement import Placement
from sg3d_jax.flagg.step import with_upper
from sg3d_jax.infer.complete import complete
from sg3d_jax.infer.lanes import root_key
from sg3d_jax.io.formats import read_graphs, write_graphs
from sg3d_jax.metrics.fgw import FGW
from sg3d_jax.metrics.oddities import check
from sg3d_jax.scene.graph import observed_of, ontology_of
from sg3d_jax.scene.ontology import PAPER_ONTOLOGY
from sg3d_jax.scene.validate import validate_graph
from sg3d_jax.train import checkpoint, loop
from sg3d_jax.train.config import to_json
from sg3d_jax.train.loop import (
    bucket_of_call,
    compile_calls,
    prepare,
    start_from_weights,
    train,
    validate,
)
from sg3d_jax.train.statistics import shares_of
from sg3d_jax.train.step import init_state, make_train_call
from sg3d_jax.train.weights import load_weights, save_weights
from tests import command_line
from tests.own_world import FLAT, NUM_OBSERVED, ONTOLOGY, PILLAR, own_world
from tests.tiny_run import read_config, untrained_weights
from tests.train import wide_run
from tests.two_rooms import CAPACITY, TWICE, on_device, random_params, two_rooms


def arrays(path):
    with np.load(path) as content:
        return {name: content[name] for name in content.files}


def assert_same_weights(one, other):
    first, second = arrays(one), arrays(other)
    assert first.keys() == second.keys()
    for name, array in first.items():
        npt.assert_array_equal(array, second[name], err_msg=name)


def log_of(directory, kind=None):
    lines = map(json.loads, (directory / "log.jsonl").read_text().splitlines())
    return [line for line in lines if kind in (None, line["kind"])]


def opened(directory):
    return checkpoint.open_checkpoints(directory / "checkpoints")


def kept_in(directory):
    return checkpoint.steps(opened(directory))


def stop_at(step, monkeypatch, error):
    """Makes the run end with an error when it would go on from a step."""
    through = loop.make_train_call(None, None)

    def call(state, key, graphs):
        if int(state.step) == step:
            raise error
        return through(state, key, graphs)

    monkeypatch.setattr(loop, "make_train_call", lambda config, model: call)


def poison(name, step, monkeypatch):
    """Makes a metric of the call from a step NaN."""
    through = loop.make_train_call(None, None)

    def call(state, key, graphs):
        first = int(state.step)
        state, metrics = through(state, key, graphs)
        return state, {**metrics, name: jnp.nan} if first == step else metrics

    monkeypatch.setattr(loop, "make_train_call", lambda config, model: call)


def without_times(lines):
    return [{k: v for k, v in line.items() if not k.startswith("seconds")} for line in lines]


def scripted(scores, monkeypatch):
    """Replaces validation by given values of FGW."""
    values = iter(scores)
    monkeypatch.setattr(loop, "validate", lambda run, params: {"fgw": next(values)})


def test_a_run_leaves_its_configuration_its_log_and_its_weights(trained):
    there = {path.name for path in trained.directory.iterdir()}
    assert there - {"tensorboard"} == {
        "config.json",
        "origins.jsonl",
        "log.jsonl",
        "lock",
        "checkpoints",
        "weights.npz",
    }
    assert (trained.directory / "config.json").read_text() == to_json(trained.run.config) + "\n"
    for kind, steps in (("train", [4, 8, 12, 16, 20, 24]), ("validation", [12, 24])):
        assert [line["step"] for line in log_of(trained.directory, kind)] == steps


def test_a_run_that_was_interrupted_goes_on_bit_for_bit(programs, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        stop_at(20, patch, KeyboardInterrupt)
        with pytest.raises(SystemExit):
            command_line.run("train", programs.file, "-o", tmp_path)
    assert [step for step, _ in kept_in(tmp_path)] == [12]
    assert not (tmp_path / "weights.npz").exists()
    command_line.run("train", programs.file, "-o", tmp_path)
    assert_same_weights(tmp_path / "weights.npz", programs.directory / "weights.npz")
    assert without_times(log_of(tmp_path)) == without_times(log_of(programs.directory))


def drawn_anew(config):
    """Returns the tiny run on views, drawn anew twice before its first checkpoint."""
    data = dataclasses.replace(config.data, name=f"{config.data.name}@robot")
    return dataclasses.replace(config, data=data, fresh_every=4)


def test_a_run_whose_data_are_drawn_anew_goes_on_bit_for_bit_and_compiles_nothing(
    programs, drawn, tmp_path, monkeypatch
):
    config, compiled = drawn_anew(programs.run.config), programs.train_call._cache_size()
    scripted([0.2, 0.1, 0.2, 0.1], monkeypatch)
    at_once = train(config, tmp_path / "at once").weights
    assert drawn == [1, 2, 3, 4, 5]
    with monkeypatch.context() as patch:
        stop_at(20, patch, KeyboardInterrupt)
        with pytest.raises(KeyboardInterrupt):
            train(config, tmp_path / "run")
    drawn.clear()
    assert_same_weights(train(config, tmp_path / "run").weights, at_once)
    assert drawn == [3, 4, 5]
    logs = [without_times(log_of(tmp_path / name, "train")) for name in ("run", "at once")]
    assert logs[0] == logs[1]
    as_ever = without_times(log_of(programs.directory, "train"))
    assert [one == other for one, other in zip(logs[0], as_ever, strict=True)] == [True] + 5 * [
        False
    ]
    assert programs.train_call._cache_size() == compiled
    drawn.clear()
    train(config, tmp_path / "run")  # it is done
    assert drawn == []


def test_a_run_whose_latest_checkpoint_is_damaged_goes_on_from_the_one_before(
    programs, tmp_path, capsys
):
    shutil.copytree(programs.directory, tmp_path, dirs_exist_ok=True)
    (tmp_path / "checkpoints" / "24" / "metrics" / "metrics").write_text("")
    done = train(programs.run.config, tmp_path)
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sg3d")]
    assert said == [
        f"sg3d: remark: {tmp_path}: set aside damaged checkpoints: 24; goes on from step 12"
    ]
    assert_same_weights(done.weights, programs.directory / "weights.npz")
    assert without_times(log_of(tmp_path)) == without_times(log_of(programs.directory))


def test_a_run_that_was_killed_between_log_and_checkpoint_validates_once(
    programs, tmp_path, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "save", lambda *given: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            train(programs.run.config, tmp_path)
    assert [line["step"] for line in log_of(tmp_path, "validation")] == [12]
    train(programs.run.config, tmp_path)
    assert without_times(log_of(tmp_path)) == without_times(log_of(programs.directory))


def origins_of(directory):
    lines = map(json.loads, (directory / "origins.jsonl").read_text().splitlines())
    return [(line["step"], line["steps"], line["training"]) for line in lines]


def test_a_finished_run_is_lengthened_by_the_schedule_of_the_new_length(programs, tmp_path, capsys):
    shutil.copytree(programs.directory, tmp_path, dirs_exist_ok=True)
    longer = dataclasses.replace(programs.run.config, steps=36)
    train(longer, tmp_path)
    sentence = "had 24 steps, now 36; from step 24 on the learning rate is that of a run of 36"
    assert f"sg3d: remark: {tmp_path}: {sentence}\n" in capsys.readouterr().err
    assert [line["step"] for line in log_of(tmp_path, "validation")] == [12, 24, 36]
    data = programs.run.digests["training"]
    assert origins_of(tmp_path) == [(0, 24, data), (24, 36, data)]
    assert load_weights(tmp_path / "weights.npz").config.steps == 36
    with pytest.raises(ValueError, match="another configuration: steps 36 there, 24 here"):
        train(programs.run.config, tmp_path)


def test_a_run_goes_on_with_other_data_only_if_that_is_wanted(
    programs, tmp_path, monkeypatch, capsys
):
    shutil.copytree(programs.directory, tmp_path, dirs_exist_ok=True)
    other = programs.run._replace(digests={**programs.run.digests, "training": "other"})
    monkeypatch.setattr(loop, "prepare", lambda config: other._replace(config=config))
    config = dataclasses.replace(programs.run.config, steps=36)
    before = (tmp_path / "config.json").read_text()
    digest = programs.run.digests["training"]
    with pytest.raises(ValueError, match=f"other data or code, training {digest} there, other he"):
        train(config, tmp_path)
    assert (tmp_path / "config.json").read_text() == before
    train(config, tmp_path, accept_changes=True)
    assert f"goes on although changed, training {digest} there" in capsys.readouterr().err
    assert origins_of(tmp_path) == [(0, 24, digest), (24, 36, "other")]


def test_a_run_of_an_earlier_version_goes_on_with_a_remark(programs, tmp_path, capsys):
    shutil.copytree(programs.directory, tmp_path, dirs_exist_ok=True)
    (tmp_path / "origins.jsonl").unlink()
    for digest in tmp_path.glob("checkpoints/*/digest"):
        digest.unlink()
    train(programs.run.config, tmp_path)
    assert "does not say what data and code it began with" in capsys.readouterr().err


def test_a_run_is_a_function_of_its_configuration(programs, tmp_path):
    weights = train(programs.run.config, tmp_path).weights
    assert_same_weights(weights, programs.directory / "weights.npz")
    again = prepare(programs.run.config)
    for one, other in zip(
        *map(jax.tree.leaves, ((again.statistics, again.stacks), programs.run[2:4])), strict=True
    ):
        npt.assert_array_equal(one, other)


def test_calls_that_were_compiled_side_by_side_do_what_the_jitted_one_does():
    config, model = wide_run.CONFIG, wide_run.Wide()
    stacks = [
        jax.tree.map(lambda leaf: np.stack([leaf] * 4), on_device(two_rooms(), capacity))
        for capacity in (CAPACITY, TWICE)
    ]
    initial, key = init_state(config, model, stacks[0]), root_key(1)
    jitted = make_train_call(config, model)
    calls = compile_calls(jitted, initial, key, stacks)
    for call, graphs in zip(calls, stacks, strict=True):
        made = [
            function(jax.tree.map(jnp.copy, initial), key, graphs) for function in (call, jitted)
        ]
        for one, other in zip(*map(jax.tree.leaves, made), strict=True):
            npt.assert_array_equal(one, other)


def test_a_finished_run_is_left_as_it_is(programs, tmp_path, monkeypatch):
    scripted([0.2, 0.1], monkeypatch)
    first = arrays(train(programs.run.config, tmp_path).weights)
    lines, origins = log_of(tmp_path), (tmp_path / "origins.jsonl").read_text()
    assert arrays(train(programs.run.config, tmp_path).weights).keys() == first.keys()
    assert log_of(tmp_path) == lines
    assert (tmp_path / "origins.jsonl").read_text() == origins


def test_the_weights_are_the_average_of_the_best_validation(programs, tmp_path, monkeypatch):
    scripted([np.inf, 0.1, 0.4], monkeypatch)
    config = dataclasses.replace(programs.run.config, validate_every=8)
    done = train(config, tmp_path)
    assert kept_in(tmp_path) == [(16, 0.1), (24, 0.4)]
    assert (done.step, done.fgw) == (16, 0.1)
    state = restored(programs, tmp_path, 16)
    loaded = load_weights(done.weights)
    for one, other in zip(*map(jax.tree.leaves, (loaded.params, state.average)), strict=True):
        npt.assert_array_equal(one, other)
    assert not all(
        np.array_equal(*pair)
        for pair in zip(*map(jax.tree.leaves, (state.params, state.average)), strict=True)
    )


def restored(trained, directory, step):
    return checkpoint.restore(opened(directory), trained.initial, step)


def test_loaded_weights_grow_what_the_run_grew(trained):
    best, fgw = min(kept_in(trained.directory), key=lambda step_and_fgw: step_and_fgw[1])
    loaded = load_weights(trained.directory / "weights.npz")
    scenes = trained.run.validation
    params = restored(trained, trained.directory, best).average
    expected, grown = (
        complete(model, of_model, scenes, seed=3, candidates=1, outgrow=False)
        for model, of_model in ((trained.run.model, params), (loaded.model, loaded.params))
    )
    for one, other in zip(*map(jax.tree.leaves, (grown, expected)), strict=True):
        npt.assert_array_equal(one, other)
    scores = validate(trained.run, loaded.params)
    assert scores["fgw"] == fgw
    logged = next(line for line in log_of(trained.directory)[::-1] if line["step"] == best)
    assert {name: logged[name] for name in scores} == scores


@pytest.mark.parametrize("name", ["loss", "gradient_norm"])
def test_a_loss_that_is_not_finite_stops_the_run(programs, tmp_path, monkeypatch, name):
    scripted([0.5], monkeypatch)
    poison(name, 16, monkeypatch)
    sentence = "between steps 16 and 20; the last good checkpoint is untouched"
    with pytest.raises(FloatingPointError, match=sentence) as caught:
        train(programs.run.config, tmp_path)
    assert str(caught.value).startswith(f"{tmp_path}: the loss is")
    assert "\n" not in str(caught.value)
    assert kept_in(tmp_path) == [(12, 0.5)]
    leaves = jax.tree.leaves(restored(programs, tmp_path, 12))
    assert all(np.isfinite(leaf).all() for leaf in leaves)


@pytest.mark.parametrize(("accumulate", "said"), [(1, True), (2, False)])
def test_accelerators_without_work_are_remarked_on(
    trained, tmp_path, monkeypatch, capsys, accumulate, said
):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    config = dataclasses.replace(trained.run.config, accumulate=accumulate)
    loop._remark_idle_devices(tmp_path, config)
    sentence = (
        "trains on 1 of 2 devices, because accumulate is 1; --accumulate 2 has a batch for each"
    )
    assert (sentence in capsys.readouterr().err) == said


def test_a_score_that_is_not_finite_is_the_worst(trained, monkeypatch):
    nothing = FGW(np.nan, np.nan, np.nan, None, False, 0)
    monkeypatch.setattr(loop, "fgw_pairs", lambda *graphs: nothing)
    assert validate(trained.run, load_weights(trained.directory / "weights.npz").params)[
        "fgw"
    ] == float("inf")


def test_a_directory_of_another_run_is_refused_by_the_fields_that_differ(trained):
    config = trained.run.config
    other = dataclasses.replace(
        config, batch=9, model=dataclasses.replace(config.model, layers=3), capacities=(32, 64)
    )
    there = [path for path in trained.directory.iterdir() if path.name != "lock"]
    before = {path: path.stat().st_mtime_ns for path in there}
    with pytest.raises(ValueError, match=r"config\.json: the run has another") as caught:
        train(other, trained.directory)
    for change in (
        "batch 2 there, 9 here",
        "model.layers 1 there, 3 here",
        "capacities [32] there",
    ):
        assert change in str(caught.value)
    assert "steps" not in str(caught.value).replace("model.topology_steps", "")
    assert {path: path.stat().st_mtime_ns for path in there} == before


def test_a_broken_run_directory_is_refused(trained, tmp_path):
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(ValueError, match=r"config\.json: not JSON at line 1"):
        train(trained.run.config, tmp_path)


def test_a_run_that_cannot_begin_leaves_no_directory(tmp_path):
    config = dataclasses.replace(
        read_config("test"), data=dataclasses.replace(read_config("test").data, name="s-g")
    )
    with pytest.raises(ValueError, match="unknown data set 's-g'"):
        train(config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_buckets_are_drawn_in_proportion_to_their_nodes_from_seed_and_call(trained):
    config = trained.run.config
    all_graphs = jax.tree.map(np.asarray, trained.run.stacks[0])
    stacks = [all_graphs, jax.tree.map(lambda leaf: leaf[:2], all_graphs)]
    shares = shares_of(stacks)
    drawn = [bucket_of_call(config, shares, call) for call in range(400)]
    assert drawn == [bucket_of_call(config, shares, call) for call in range(400)]
    all_nodes, two_graphs = (int(np.sum(stack.nodes.mask)) for stack in stacks)
    npt.assert_allclose(np.mean(drawn), two_graphs / (all_nodes + two_graphs), atol=0.08)
    other = dataclasses.replace(config, seed=1)
    assert drawn != [bucket_of_call(other, shares, call) for call in range(400)]


def test_every_loss_of_the_model_is_there_and_finite(trained):
    names = {"loss", "label", "edge", "distance", "insert", "halt", "gradient_norm"}
    assert trained.run.config.flagg.coins == (1, 4)
    for line in log_of(trained.directory, "train"):
        assert names <= line.keys()
        assert all(np.isfinite(line[name]) and line[name] > 0 for name in names)


def test_the_loss_of_the_model_falls_within_few_steps(trained):
    losses = [line["loss"] for line in log_of(trained.directory, "train")]
    assert np.mean(losses[-2:]) < 0.8 * losses[0]


def test_every_parameter_of_the_model_receives_a_finite_gradient(trained):
    last = restored(trained, trained.directory, trained.run.config.steps)
    paths, leaves = zip(*jax.tree.leaves_with_path(last.params), strict=True)
    ends = np.cumsum([leaf.size for leaf in leaves])  # the optimiser holds one vector
    squares = np.split(np.asarray(optax.tree.get(last.optimiser, "nu")), ends[:-1])
    for path, square in zip(paths, squares, strict=True):
        assert np.isfinite(square).all(), path
        assert np.any(square > 0), path


def test_initial_parameters_follow_from_the_seed(trained):
    graph = jax.tree.map(lambda leaf: np.asarray(leaf)[0], trained.run.stacks[0])
    config = dataclasses.replace(trained.run.config, seed=1)
    states = (
        trained.initial,
        *(init_state(chosen, trained.run.model, graph) for chosen in (trained.run.config, config)),
    )
    first, again, other = (
        np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(state.params)])
        for state in states
    )
    npt.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_run_starts_from_weights_with_a_fresh_optimiser(programs):
    weights = str(programs.directory / "weights.npz")
    config = dataclasses.replace(programs.run.config, initial=weights)
    state = start_from_weights(config, programs.initial)
    for params in (state.params, state.average):
        jax.tree.map(npt.assert_array_equal, params, load_weights(weights).params)
    assert state.optimiser is programs.initial.optimiser
    assert state.step == 0
    assert start_from_weights(programs.run.config, programs.initial) is programs.initial


def test_upper_layers_start_from_weights_that_have_none_and_are_left_out_where_none_are_wanted(
    programs, tmp_path
):
    weights, plain = str(programs.directory / "weights.npz"), programs.run.config
    known, flagg = load_weights(weights), dataclasses.replace(plain.flagg, upper="floor")
    config = dataclasses.replace(plain, flagg=flagg, initial=weights)
    template = programs.initial._replace(params=with_upper(programs.initial.params, flagg))
    params = start_from_weights(config, template).params
    for own in (params.upper, params.fill):
        jax.tree.map(npt.assert_array_equal, own, known.params.fill)
    learnt = params._replace(upper=jax.tree.map(lambda leaf: leaf + 1, params.upper))
    path = save_weights(tmp_path / "upper.npz", config, known.statistics, learnt)
    again = start_from_weights(dataclasses.replace(config, initial=str(path)), template).params
    jax.tree.map(npt.assert_array_equal, again, learnt)
    without = dataclasses.replace(plain, initial=str(path))
    params = start_from_weights(without, programs.initial).params
    jax.tree.map(npt.assert_array_equal, params, known.params)


def test_a_placement_starts_afresh_where_weights_have_none_and_goes_on_where_they_have_one(
    programs, tmp_path
):
    weights, plain = str(programs.directory / "weights.npz"), programs.run.config
    known, flagg = load_weights(weights), dataclasses.replace(plain.flagg, placement=(4, 2, 1))
    config = dataclasses.replace(plain, flagg=flagg, initial=weights)
    places = random_params(Placement(4, 2, 1).init, on_device(own_world(), TWICE))
    template = programs.initial._replace(
        params=programs.initial.params._replace(placement=places),
    )
    params = start_from_weights(config, template).params
    jax.tree.map(npt.assert_array_equal, params, known.params._replace(placement=places))
    learnt = params._replace(placement=jax.tree.map(lambda leaf: leaf + 1, places))
    path = save_weights(tmp_path / "placement.npz", config, known.statistics, learnt)
    again = start_from_weights(dataclasses.replace(config, initial=str(path)), template).params
    jax.tree.map(npt.assert_array_equal, again, learnt)
    without = dataclasses.replace(plain, initial=str(path))
    params = start_from_weights(without, programs.initial).params
    jax.tree.map(npt.assert_array_equal, params, known.params)


@pytest.mark.parametrize("other", ["ec-square", "fd4-s-f"])
def test_weights_of_another_method_or_of_other_sizes_are_no_start(other, programs, tmp_path):
    name = other if other == "fd4-s-f" else str(untrained_weights(tmp_path, other))
    config = dataclasses.replace(programs.run.config, initial=name, ontology=PAPER_ONTOLOGY)
    with pytest.raises(ValueError, match=rf"initial: {name} are weights of .* with other layers"):
        train(config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_world_of_ones_own_needs_a_configuration_alone(trained, tmp_path, monkeypatch, capsys):
    """Concepts are data, from training to every format."""
    monkeypatch.chdir(tmp_path)
    weights = trained.directory / "weights.npz"
    loaded = load_weights(weights)
    assert loaded.config.ontology == loaded.model.ontology == ONTOLOGY
    assert len(loaded.statistics.label) == ONTOLOGY.num_concepts
    assert loaded.statistics.label[FLAT] > 0 == loaded.statistics.label[PILLAR]
    config = json.loads((trained.directory / "config.json").read_text())
    assert [concept["name"] for concept in config["ontology"]["concepts"]] == [*ONTOLOGY.names]

    # Scored.
    command_line.run("evaluate", weights, "--num-graphs", 2, "-o", "scores.json")
    scores = json.loads(Path("scores.json").read_text())["scores"]
    assert np.isfinite(scores["fgw"]["mean"])
    assert "recall, flat" in scores

    # Grown, from pillars and planes as a document holds them.
    write_graphs("observed.json", [observed_of(own_world())])
    command_line.run("complete", "observed.json", "-o", "grown.json", "--weights", weights)
    (grown,) = read_graphs("grown.json")
    assert ontology_of(grown) == ONTOLOGY
    assert grown.nodes.observed.sum() == NUM_OBSERVED
    assert not ONTOLOGY.is_observed[grown.nodes.label[NUM_OBSERVED:]].any()
    validate_graph(grown, "grown.json", rules=False)
    validate_graph(own_world(), "own world")
    assert check([own_world()]) == []
    said = capsys.readouterr().out
    assert re.search(r"grown\.json: scene 0 sample 0: 12 planes, 2 pillars", said)

    # Drawn, and written in every format and read back.
    command_line.run("view", "grown.json", "-o", "grown.png")
    command_line.run("view", "grown.json", "-o", "grown.html")
    assert "flat" in Path("grown.html").read_text()
    for to, suffix in (
        ("json", "json"),
        ("networkx", "json"),
        ("spark-dsg", "json"),
        ("graphml", "graphml"),
        ("npz", "npz"),
    ):
        command_line.run("export", "grown.json", "-o", f"{to}.{suffix}", "--to", to)
        (back,) = read_graphs(f"{to}.{suffix}")
        assert ontology_of(back) == ONTOLOGY
        npt.assert_array_equal(back.nodes.label, grown.nodes.label)
        npt.assert_array_equal(back.nodes.position, grown.nodes.position)
