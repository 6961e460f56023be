"""Any tick of any log is solved again, bit for bit; nothing is executed from a log; two runs part where they do."""

import enum
import inspect
import json
import typing
from array import array
from collections.abc import Mapping
from dataclasses import is_dataclass

import numpy as np
import pinocchio as pin
import pytest
import runs
from click.testing import CliRunner

import wbc
from wbc.again import again
from wbc.arguments import Arguments
from wbc.build import build
from wbc.cli import main
from wbc.errors import LogError
from wbc.invariant import Watched
from wbc.ladder import Status
from wbc.log import Log
from wbc.memory import Memory
from wbc.pack import Codec, Foreign
from wbc.part import differ, part, settings
from wbc.run import run
from wbc.tape import CODEC

RUNS = {
    "eraser": ("duration=0.3",),
    "chalk_liftoff": ("phases.approach.timeout=0.15", "phases.approach.else=write", "duration=0.4"),
    "eraser_noisy": ("duration=0.3",),
    "go2_step": ("phases.unload_FL.until.time=0.1", "duration=0.45"),
    "g1_wipe_noisy": ("phases.approach.timeout=0.15", "phases.approach.else=wipe", "duration=0.25"),
    "impedance": ("duration=0.15",),
}


def again_as(name, *overrides):
    return wbc.Replay(runs.result(name, *overrides).log)


def unequal(replay):
    """Ticks that are not answered as they were recorded."""
    return [tick for tick, ctl, given in replay.each() if not replay.recorded(tick).same(ctl.step(*given))]


@pytest.fixture(scope="module")
def eraser(tmp_path_factory):
    """Two runs as files, the same but for one gain."""
    folder = tmp_path_factory.mktemp("runs")
    for name, ki in (("a", 10), ("b", 11)):
        runs.result("eraser", "duration=0.3", *([f"tasks.press.ki={ki}"] if ki != 10 else [])).log.save(
            folder / f"{name}.npz"
        )
    return folder


def command(*words):
    """(exit status, standard output, standard error) of a command."""
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.stdout, done.stderr


class TestBits:
    @pytest.mark.parametrize("name", RUNS)
    def test_every_tick_comes_back(self, name):
        replay = again_as(name, *RUNS[name])
        assert len(replay) > 100
        assert not replay.notes
        assert unequal(replay) == []

    def test_phases_change_within_these_runs(self):
        for name in ("chalk_liftoff", "go2_step", "g1_wipe_noisy"):
            replay = again_as(name, *RUNS[name])
            phases = {replay.remembered(tick).phase for tick in replay.checkpoints}
            assert len(phases) > 1, name

    @pytest.mark.parametrize("override", ["hierarchy=strict", "gravity=robot"])
    def test_with_levels_and_a_driver_that_adds_gravity(self, override):
        assert unequal(again_as("eraser", "duration=0.15", override)) == []

    def test_a_solver_that_remembers_begins_anew_at_checkpoints(self):
        """Its last bit depends on where its memory lies; what it remembers would show in the tenth digit."""
        told = again(again_as("eraser", "duration=0.15", "solver=proxqp"))
        assert told["max_tau_difference"] < 1e-12

    def test_one_tick_is_reached_from_the_checkpoint_before(self):
        replay = again_as("chalk_liftoff", *RUNS["chalk_liftoff"])
        for tick in (0, 99, 100, 101, 173, len(replay) - 1):
            controller, arguments = replay.at(tick)
            assert controller.memory.t is None or controller.memory.t < arguments.t
            assert replay.recorded(tick).same(controller.step(*arguments))
        gaps = np.diff([*replay.checkpoints, len(replay)])
        assert 0 < gaps.max() <= 100

    def test_a_wrong_torque_is_found(self, eraser, tmp_path):
        """One bit of one recorded torque."""
        flipped = altered(eraser / "a.npz", tmp_path, "answered", 7 * 123 + 4)
        status, out, _ = command("replay", flipped, "--json")
        told = json.loads(out)
        assert status == 1
        assert not told["ok"]
        assert told["equal"] == told["ticks"] - 1
        assert (told["first"]["tick"], told["first"]["joint"]) == (123, "joint5")


def altered(file, folder, name, i):
    """A copy of a log with the lowest bit of one number flipped."""
    with np.load(file) as npz:
        arrays = {key: npz[key] for key in npz.files}
    bits = arrays[f"tape/{name}"].copy()
    bits.view(np.uint64)[i] ^= 1
    arrays[f"tape/{name}"] = bits
    np.savez_compressed(folder / f"{name}.npz", **arrays)
    return folder / f"{name}.npz"


def filled(kind, rng):
    """A value of a declared type in which nothing has its default."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is not None and (origin is Mapping or issubclass(origin, Mapping) if isinstance(origin, type) else False):
        return {name: filled(inner[1], rng) for name in ("press", "draw")}
    if origin is tuple:
        return tuple(filled(inner[0], rng) for _ in range(3))
    if origin is np.ndarray:
        return rng.normal(size=(3, 2)) if rng.random() < 0.5 else np.asfortranarray(rng.normal(size=(2, 3)))
    if inner:  # a union: never its None
        return filled(next(each for each in inner if each is not type(None)), rng)
    if kind in (float, int, str, bool):
        return {float: rng.normal(), int: int(rng.integers(1, 2**40)), str: f"why {rng.random()}", bool: True}[kind]
    if kind is pin.SE3:
        return pin.SE3.Random()
    if issubclass(kind, enum.Enum):
        return list(kind)[-1]
    assert hasattr(kind, "_fields") or is_dataclass(kind), kind
    return kind(**{name: filled(each, rng) for name, each in typing.get_type_hints(kind).items()})


class TestPack:
    def test_every_field_of_the_memory(self, rng):
        memory = filled(Memory, rng)
        missing = [name for name, value in memory._asdict().items() if value is None]
        assert not missing
        assert memory.status is not Status.OK
        assert list(differ(memory, through(memory))) == []

    def test_differ_sees_every_field(self, rng):
        """Else the test above could not fail."""
        one, other = filled(Memory, rng), filled(Memory, rng)
        seen = {each.what.split(".")[0].split("[")[0] for each in differ(one, other)}
        assert seen == set(Memory._fields) - {"status"}

    @pytest.mark.parametrize(
        "value",
        [
            None, True, 3, -0.0, 2**70, "texts: \u2202 \n", (1.0, [2, None]), {"a": {"b": 1}}, np.float64(1.5),
            np.array([1, 2], np.int32), np.float32(0.1), np.zeros((0, 6)), np.array(3.0), Status.SAFE_HOLD,
            wbc.Wrench(np.arange(6.0), "tool"), np.array([np.nan, np.inf, -np.inf, 5e-324]),
        ],
    )  # fmt: skip
    def test_a_value_comes_back(self, value):
        found = through(value)
        assert type(found) is type(value)
        assert not list(differ(value, found))

    def test_the_order_of_an_array_stays(self, rng):
        assert through(np.asfortranarray(rng.normal(size=(3, 2)))).flags.f_contiguous

    def test_what_is_no_value_is_told(self):
        assert through({"board": object()})["board"].told == "object"
        assert isinstance(through(lambda: None), Foreign)


def through(value):
    """Packed, written as JSON, read, unpacked."""
    numbers = array("d")
    structure = json.loads(json.dumps(CODEC.pack(value, numbers)))
    return CODEC.unpack(structure, np.array(numbers, float))


class TestOwnLoop:
    def test_what_takes_a_controllers_place_is_called_as_it_is(self):
        """One signature: that of `Controller.step`, whose arguments `Arguments` holds in their order."""
        own = inspect.signature(wbc.Controller.step)
        for takes in (wbc.Tape.step, Watched.step):
            assert inspect.signature(takes) == own
        told, held = list(own.parameters.values())[1:], list(inspect.signature(Arguments).parameters.values())
        assert [(each.name, each.default) for each in held] == [(each.name, each.default) for each in told]

    def recorded(self, **changes):
        """A loop that has everything go wrong, on a controller without a spec; the tape, and the answers."""
        built = build(wbc.load("eraser", [f"{key}={value}" for key, value in changes.items()]))
        controller, q = built.controller, built.q
        tape, outs, v = wbc.Tape(controller), [], np.zeros(7)
        nothing, nan = wbc.Wrench(np.array([0.0, 0, 0, 0, 0, -9.0]), "eraser"), np.full(7, np.nan)
        given = [{"q": q, "v": v}] * 3
        given += [{"q": q, "v": v, "measured": {"board": nothing}, "targets": {"board.fz": -12.0}}] * 3
        given += [{"q": q, "v": v, "tau_applied": np.full(7, 0.1), "missed": 2}, {"q": q.tolist(), "v": v}]
        given += [{"q": q, "v": v[:3]}, {"q": q, "v": v, "measured": {"board": "a text", "wall": None}}]
        given += [{"q": nan, "v": v}] * 8 + [{"q": q, "v": v}]
        for i, each in enumerate(given * 2):
            if i == len(given):
                controller.reset(q, v)
            outs.append(tape.step(1e-3 * i, **each))
        outs.append(tape.step(1.0, q, v, missed=25))
        return tape, controller, outs

    def test_every_tick_comes_back_without_a_spec(self, tmp_path):
        tape, controller, outs = self.recorded()
        assert {out.status for out in outs} == set(Status) - {Status.OK}
        tape.save(tmp_path / "own.npz")
        replay = wbc.Replay(tmp_path / "own.npz", controller)
        assert len(replay) == len(outs)
        assert unequal(replay) == []
        for tick in range(len(outs)):
            controller, arguments = replay.at(tick)
            assert replay.recorded(tick).same(controller.step(*arguments))

    def test_another_controller_of_the_same_kind_answers_the_same(self):
        tape, _, _ = self.recorded()
        assert unequal(wbc.Replay(tape, build(wbc.load("eraser")).controller)) == []

    def test_a_log_without_a_spec_says_so(self, tmp_path):
        self.recorded()[0].save(tmp_path / "own.npz")
        status, _, err = command("replay", tmp_path / "own.npz")
        assert status == 2
        assert "no spec" in err

    def test_a_safe_hold_on_ground_that_moves(self):
        """Where the ground is now is known from the memory alone, also to a controller that was not there before."""
        built = build(wbc.load("go2_ride"))
        tape, v = wbc.Tape(built.controller, built.spec), np.zeros(18)
        for i in range(130):
            tape.step(1e-2 * i, built.q if i < 60 else np.full(19, np.nan), v)
        controller, arguments = wbc.Replay(tape).at(125)
        assert controller.memory.status is Status.SAFE_HOLD
        assert wbc.Replay(tape).recorded(125).same(controller.step(*arguments))

    def test_a_driver_that_the_spec_does_not_know(self):
        robot = wbc.Robot.load("panda", tool="eraser", scene="board", gravity="robot")
        spec = wbc.load("eraser")
        controller = wbc.Controller.from_spec(spec, robot=robot)
        tape = wbc.Tape(controller, spec)
        for i in range(5):
            tape.step(1e-3 * i, controller.start, np.zeros(7))
        assert unequal(wbc.Replay(tape)) == []

    def test_recording_changes_no_torque(self):
        _, _, outs = self.recorded()
        built = build(wbc.load("eraser"))
        for i, out in enumerate(outs[:3]):
            assert built.controller.step(1e-3 * i, built.q, np.zeros(7)).tau.tobytes() == out.tau.tobytes()


class TestChanges:
    def test_another_solver_answers_the_same_within_its_tolerance(self):
        told = again(again_as("eraser", "duration=0.3"), solver="proxqp")
        assert told["changed"]
        assert 0.0 < told["max_tau_difference"] < 1e-6

    def test_a_limit_is_named(self):
        replay = again_as("eraser", "duration=0.3")
        told = again(replay, 250, overrides=["limits.torque={joint2: 18}"])
        assert "torque[joint2]" in told["replayed"]["active"]
        assert told["replayed"]["status"] == "LIMITED"
        assert abs(told["replayed"]["tau"]["joint2"]) <= 18.0 < abs(told["recorded"]["tau"]["joint2"])
        assert not told["equal"]
        assert told["recorded"]["active"] == []

    def test_a_gain_that_is_the_same_changes_nothing(self):
        told = again(again_as("eraser", "duration=0.3"), overrides=["tasks.press.ki=10"])
        assert told["equal"] == told["ticks"]

    def test_another_model_is_told(self, eraser, tmp_path):
        with np.load(eraser / "a.npz") as npz:
            arrays = {key: npz[key] for key in npz.files}
        about = json.loads(str(arrays["tape/about"]))
        arrays["tape/about"] = np.array(json.dumps(about | {"model": "0" * 64, "solver": "Mine"}))
        np.savez_compressed(tmp_path / "log.npz", **arrays)
        notes = wbc.Replay(tmp_path).notes  # the folder of a run
        assert any("model" in note for note in notes)
        assert any("Mine" in note for note in notes)

    def test_a_spec_that_has_changed_since_still_replays(self, tmp_path):
        file = tmp_path / "mine.yaml"
        file.write_text(_shipped("eraser"))
        finished = run(build(wbc.load(str(file), ["duration=0.02", "tasks.press.kp=0.2"])))
        finished.log.save(tmp_path / "log.npz")
        file.write_text("robot: no more")
        replay = wbc.Replay(tmp_path / "log.npz")
        assert unequal(replay) == []
        assert len(replay) == 20

    def test_another_robot_is_refused(self):
        with pytest.raises(LogError, match="other joints"):
            again_as("eraser", "duration=0.3").other(overrides=["robot=ur5e"])


def _shipped(name):
    from wbc.resources import find_file

    return find_file("tasks", name, ".yaml").read_text()


class TestPart:
    def test_the_same_run_twice(self, eraser):
        status, out, _ = command("replay", "--bisect", eraser / "a.npz", eraser / "a.npz", "--json")
        assert status == 0
        assert json.loads(out)["parting"] is None

    def test_one_gain(self, eraser):
        """The integral is the same until the command differs: from the first tick with a measured wrench."""
        status, out, _ = command("replay", "--bisect", eraser / "a.npz", eraser / "b.npz", "--json")
        told = json.loads(out)
        assert status == 1
        assert told["settings"] == [{"what": "tasks.press.ki", "a": 10.0, "b": 11.0}]
        a, b = (wbc.Replay(eraser / name) for name in ("a.npz", "b.npz"))
        tick = told["parting"]["tick"]
        first = next(i for i in range(len(a)) if a.recorded(i).tau.tobytes() != b.recorded(i).tau.tobytes())
        assert (tick, told["parting"]["where"]) == (first, "output")
        assert 0 < tick < 10
        assert told["parting"]["differences"][0]["what"].startswith("torque joint")

    def test_two_seeds(self):
        one, other = (
            wbc.Replay(run(build(wbc.load("eraser_noisy", ["duration=0.02"])), seed=seed).log) for seed in (1, 2)
        )
        parting = part(one, other)
        assert parting.where == "input"
        whats = {each.what.split(".")[0].split("[")[0] for each in parting.differences}
        assert whats <= {"measured", "q", "v"}
        assert not settings(one, other)

    def test_one_bit_of_one_input(self, eraser, tmp_path):
        one = wbc.Replay(eraser / "a.npz")
        tick, joint, sizes = 217, 3, [len(one.given.raw(i)[1]) // 8 for i in range(218)]
        file = altered(eraser / "a.npz", tmp_path, "given", sum(sizes[:tick]) + 1 + joint)
        parting = part(one, wbc.Replay(file))
        assert (parting.tick, parting.where) == (tick, "input")
        (only,) = parting.differences
        assert only.what == f"q[{joint}]"
        assert only.a != only.b
        assert abs(only.a - only.b) < 1e-15

    def test_a_memory_that_differs_before_any_torque_does(self, tmp_path):
        """Somebody else wrote to the memory: what a tick answers does not depend on `good` yet."""
        replays = []
        for disturbed in (False, True):
            built = build(wbc.load("eraser"))
            tape = wbc.Tape(built.controller, built.spec)
            for i in range(30):
                if disturbed and i == 20:
                    built.controller.memory = built.controller.memory._replace(good=500)
                tape.step(1e-3 * i, built.q, np.zeros(7))
            replays.append(wbc.Replay(tape))
        parting = part(*replays)
        assert (parting.where, parting.differences[0].what) == ("memory", "memory.good")

    def test_one_is_longer(self, eraser, tmp_path):
        runs.result("eraser", "duration=0.15").log.save(tmp_path / "short.npz")
        parting = part(wbc.Replay(eraser / "a.npz"), wbc.Replay(tmp_path / "short.npz"))
        assert (parting.tick, parting.where) == (150, "length")


class TestForeignFiles:
    def test_what_is_no_log(self, tmp_path, eraser):
        whole = (eraser / "a.npz").read_bytes()
        (tmp_path / "text.npz").write_text("robot: panda")
        (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
        middle = len(whole) // 2
        (tmp_path / "rotten.npz").write_bytes(whole[:middle] + bytes(2000) + whole[middle + 2000 :])
        np.savez(tmp_path / "other.npz", a=np.zeros(3))
        np.savez(tmp_path / "pickled.npz", **{"tape/about": np.array([Evil()], object)})
        Log(1).save(tmp_path / "without.npz")
        for name in ("text", "cut", "other", "pickled", "without", "missing"):
            status, out, err = command("replay", tmp_path / f"{name}.npz", "--json")
            assert (status, len(err.splitlines()), name in err) == (2, 1, True), err
            assert json.loads(out)["ok"] is False
        assert command("replay", tmp_path / "rotten.npz")[0] in (0, 1, 2)  # what is rotten may not be needed
        assert not Evil.ran

    @pytest.mark.parametrize(
        "name", ["about", "kinds", "checkpoints", "given.kind", "given", "answered", "memory.kind", "memory"]
    )
    def test_an_array_that_is_not_what_it_should_be(self, name, eraser, tmp_path, rng):
        with np.load(eraser / "a.npz") as npz:
            arrays = {key: npz[key] for key in npz.files if key.startswith("tape/")}
        whole = arrays[f"tape/{name}"]
        wrong = [
            np.zeros(3),
            np.array("[]"),
            np.array("{"),
            np.zeros((2, 2), int),
            np.array("[" * 5000),
            whole[:-1] if whole.ndim else whole[None],
        ]
        wrong += [np.array("null"), np.array([7, 3, -5]), np.array(5), None]
        for each in wrong:
            found = {key: array for key, array in arrays.items() if key != f"tape/{name}"}
            np.savez(tmp_path / "log.npz", **(found | ({} if each is None else {f"tape/{name}": each})))
            status, _, err = command("replay", tmp_path / "log.npz", "--tick", 5)
            assert (status, len(err.splitlines())) == (2, 1), (each, err)

    def test_kinds_that_lie(self, eraser, tmp_path):
        """Every structure in turn is another one: a message or another answer, never an exception."""
        with np.load(eraser / "a.npz") as npz:
            arrays = {key: npz[key] for key in npz.files if key.startswith("tape/")}
        kinds = json.loads(str(arrays["tape/kinds"]))
        for i in range(len(kinds)):
            for other in (["n", "Memory"], ["n", "object", ["a", "f"]], ["?", "x"], ["d", [["l"], None]], ["z"], 7):
                lied = [*kinds[:i], other, *kinds[i + 1 :]]
                np.savez(tmp_path / "log.npz", **(arrays | {"tape/kinds": np.array(json.dumps(lied))}))
                with pytest.raises(LogError):
                    read_all(tmp_path / "log.npz")

    def test_only_known_records_are_made(self):
        assert set(Codec(Memory)._known) == set(CODEC._known) - {"Wrench"}
        for structure in (
            ["n", "Popen", ["args", ["s", "true"]]],
            ["e", "Status", "mro"],
            ["b", False, "O", [1], "00"],
        ):
            with pytest.raises((ValueError, LookupError, TypeError)):
                CODEC.unpack(structure, np.zeros(0))

    def test_usage(self, eraser):
        log = eraser / "a.npz"
        for words in (
            (),
            (log, "--bisect", log, log),
            (log, "--tick", 1, "--at", 0.1),
            ("--bisect", log, log, "--tick", 1),
        ):
            assert command("replay", *words)[0] == 2
        for words in (
            ("--tick", 5000),
            ("--at", -1.0),
            ("--solver", "nobody"),
            ("--set", "tasks.pres.kp=1"),
            ("--set", "expect.settle=0"),
        ):
            status, _, err = command("replay", log, *words)
            assert (status, bool(err.strip())) == (2, True), words


def read_all(file):
    replay = wbc.Replay(file)
    for tick in range(len(replay)):
        replay.arguments(tick)
        replay.recorded(tick)
    for tick in replay.checkpoints:
        replay.remembered(tick)


class Evil:
    """Says so when it is unpickled."""

    ran = False

    def __reduce__(self):
        return Evil._run, ()

    @staticmethod
    def _run():
        Evil.ran = True
