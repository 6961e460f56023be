"""The picture of a run: it is written whatever the run was, and what it shows is what the log and the summary say."""

import struct
import subprocess
import sys
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from wbc.log import Log
from wbc.plot import figure, report

STATUS = ["OK", "LIMITED", "DEGRADED", "SAFE_HOLD", "STOPPED"]
BOARD = {"board": ["mx", "my", "fz"]}
FOOT = ["mx", "my", "mz", "fx", "fy", "fz"]
DT = 0.001


def make_log(
    ticks: int = 200,
    contacts: dict[str, list[str]] | None = None,
    motions: tuple[str, ...] = ("draw",),
    joints: int = 7,
    settle: float = 0.05,
    **changes: Any,
) -> Log:
    """A run that presses with 10 N, draws an ellipse and is 1 mm and 2 mrad off; `changes` replace quantities."""
    contacts = BOARD if contacts is None else contacts
    names = [f"joint{i + 1}" for i in range(joints)]
    meta = {
        "title": "A made-up run",
        "robot": "arm",
        "joints": names,
        "status_names": STATUS,
        "settle": settle,
        "dt": DT,
    }
    log = Log(ticks + 3, {**meta, "contacts": contacts, "motions": list(motions)})
    for i in range(ticks):
        angle, limit = 2 * np.pi * i / 200, np.full(joints, 50.0)
        path = np.array([0.5 + 0.06 * np.sin(angle), 0.03 * np.cos(angle), 0.3])
        row: dict[str, Any] = {"t": i * DT, "tau": 20.0 * np.sin(angle + np.arange(joints)), "tau_min": -limit}
        row |= {"tau_max": limit, "status": 0, "step_us": 300.0 + i}
        for name, axes in contacts.items():
            target = np.array([-10.0 if axis == "fz" else 0.0 for axis in axes])
            row |= {f"{name}.true": np.zeros(6), f"{name}.lam": target + 1e-3, f"{name}.target": target}
        for name in motions:
            row |= {f"{name}.desired": path, f"{name}.position": path + np.array([1e-3, 0, 0]), f"{name}.speed": 0.1}
            row[f"{name}.error"] = np.array([0, 0, 2e-3, 1e-3, 0, 0])
        log.append((), **row | {key: change(i) for key, change in changes.items()})
    return log


def make_summary(log: Log, *checks: dict[str, Any], **more: Any) -> dict[str, Any]:
    ok = all(check["ok"] for check in checks) and "broken" not in more
    us = {"p50": 400.0, "p99": 500.0, "max": 600.0}
    return {"spec": "made_up", "ok": ok, "ticks": log.size, "checks": list(checks), "step_us": us, "notes": [], **more}


def check(name: str, value: float, bound: Any, ok: bool) -> dict[str, Any]:
    return {"name": name, "value": value, "bound": bound, "ok": ok}


def panels(fig: Figure) -> dict[str, Axes]:
    return {str(ax.get_label()): ax for ax in fig.axes}


def texts(artist: Figure | Axes) -> str:
    """All that can be read in it."""
    return "\n".join(text.get_text() for text in artist.findobj(Text) if text.get_visible())


def labels(ax: Axes) -> list[str]:
    return ax.get_legend_handles_labels()[1]


def absent(first: int, size: int) -> Any:
    return lambda i: np.full(size, np.nan if i < first else -10.0)


FEET = {f"foot{i}": FOOT for i in range(6)}
ODD: dict[str, Log] = {
    "arm": make_log(),
    "one tick": make_log(1),
    "ended while settling": make_log(20),
    "no contact": make_log(contacts={}),
    "contact only": make_log(motions=()),
    "neither": make_log(contacts={}, motions=()),
    "several contacts": make_log(contacts={**BOARD, "left_foot": FOOT, "right_foot": FOOT}),
    "more contacts than places": make_log(contacts=FEET),
    "a contact without multipliers": make_log(contacts={"free": []}),
    "named multipliers": make_log(contacts={"handle": ["lambda1", "lambda2"]}),
    "two motions": make_log(motions=("reach", "swing")),
    "planar": make_log(contacts={"board": ["my", "fz"]}, joints=3),
    "many joints": make_log(joints=29),
    "contact made late": make_log(**{"board.lam": absent(120, 3), "board.target": absent(120, 3)}),
    "contact never made": make_log(**{"board.lam": absent(1000, 3), "board.target": absent(1000, 3)}),
    "motion never asked": make_log(**{f"draw.{key}": absent(1000, 3) for key in ("desired", "position")}),
    "standing still": make_log(**{"draw.desired": lambda i: np.zeros(3), "draw.position": lambda i: np.zeros(3)}),
    "exact": make_log(**{"draw.error": lambda i: np.zeros(6), "board.lam": lambda i: np.array([0, 0, -10.0])}),
    "no torque limits": make_log(tau_min=lambda i: np.full(7, -np.inf), tau_max=lambda i: np.full(7, np.inf)),
    "blown up": make_log(
        **{"tau": lambda i: np.full(7, 10.0 ** min(i, 300)), "board.lam": lambda i: np.full(3, 1e200)}
    ),
    "not a number": make_log(**{"tau": absent(50, 7), "step_us": lambda i: np.nan if i == 7 else 1.0}),
    "a long run": make_log(9000),
    "nothing": make_log(0),
}


@pytest.mark.parametrize("name", ODD)
def test_the_picture_is_written_whatever_the_run_was(name, tmp_path):
    path = tmp_path / "report.png"
    report(ODD[name], make_summary(ODD[name], check("a.b", 1.0, 2.0, True), broken="it blew up"), path)
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", head[16:24]) == (1600, 1200)


def test_matplotlib_is_left_as_it_was(tmp_path):
    before = dict(matplotlib.rcParams)
    report(make_log(5), make_summary(make_log(5)), tmp_path / "report.png")
    assert dict(matplotlib.rcParams) == before
    code = "import sys, wbc.plot; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_pass_says_so():
    log = make_log()
    said = texts(figure(log, make_summary(log, check("board.fz.rms_error", 0.001, 0.005, True))))
    assert "PASS" in said
    assert "FAIL" not in said
    for word in ("A made-up run", "arm, 7 joints", "200 ticks of 1 ms", "400 µs (p50), 500 µs (p99)", "settling"):
        assert word in said


def test_a_fail_names_what_failed_first():
    log = make_log()
    checks = [check(f"fine{i}", 0.1, 1.0, True) for i in range(20)] + [check("board.fz.rms_error", 0.02, 0.005, False)]
    fig = figure(log, make_summary(log, *checks))
    assert "failed: board.fz.rms_error" in texts(fig)
    table = [text.get_text() for text in panels(fig)["checks"].texts if text.get_text()]
    assert table[:6] == ["value", "bound", "board.fz.rms_error", "0.02", "≤ 0.005", "FAIL"]
    assert table[6:10] == ["fine0", "0.1", "≤ 1", "ok"]
    assert "and 9 more" in table


@pytest.mark.parametrize(
    ("bound", "told"), [({"min": 2}, "≥ 2"), ({"min": 0.5, "max": 1e-3}, "0.5 … 0.001"), (0, "≤ 0")]
)
def test_bounds_are_told_in_words(bound, told):
    log = make_log(5)
    assert told in texts(panels(figure(log, make_summary(log, check("a", float("nan"), bound, False))))["checks"])


def test_a_broken_simulation_is_told_in_red():
    log = make_log()
    fig = figure(log, make_summary(log, broken="QACC is not finite at t = 0.2 s"))
    (told,) = [text for text in fig.texts if "QACC is not finite" in text.get_text()]
    assert told.get_color() == "#c53030"
    assert "FAIL" in texts(fig)


def test_a_run_that_ends_while_settling_is_not_taken_for_a_success():
    log = make_log(20)
    assert "ended while settling" in texts(figure(log, make_summary(log)))
    assert "ended while settling" not in texts(figure(make_log(), make_summary(log)))


def test_each_contact_shows_what_it_holds_its_target_and_its_error():
    log = make_log()
    axes = panels(figure(log, make_summary(log)))
    assert labels(axes["board [N m]"]) == ["mx", "my", "target"]
    assert labels(axes["board [N]"]) == ["fz", "target"]
    assert axes["board [N]"].lines[0].get_ydata() == pytest.approx(log["board.lam"][:, 2])
    assert axes["board [N]"].lines[1].get_ydata() == pytest.approx(-10.0)
    error = axes["board error [N]"]
    assert error.get_ylabel() == "error\n[mN]"
    assert error.lines[0].get_ydata() == pytest.approx(1.0)
    assert labels(error) == ["fz rms 1"]


def test_the_error_is_framed_by_what_is_settled():
    log = make_log(**{"board.lam": lambda i: np.array([0, 0, 90.0 if i < 50 else -10.0 + 2e-3])})
    low, high = panels(figure(log, make_summary(log)))["board error [N]"].get_ylim()
    assert -2 < low < 0 < 2 < high < 5  # [mN]


def test_rounding_is_not_blown_up_to_look_like_chatter():
    log = make_log(**{"board.lam": lambda i: np.array([0.0, 0.0, -10.0 + 1e-8 * (-1) ** i])})
    low, high = panels(figure(log, make_summary(log)))["board error [N]"].get_ylim()
    assert low <= -10.0  # [µN]
    assert high >= 10.0


def test_a_contact_without_a_target_has_no_error():
    log = make_log()
    del log._arrays["board.target"]
    axes = panels(figure(log, make_summary(log)))
    assert "board [N]" in axes
    assert "board error [N]" not in axes


def test_contacts_beyond_the_places_are_named():
    axes = figure(ODD["more contacts than places"], make_summary(ODD["arm"])).axes
    assert sum("holds" in ax.get_title(loc="left") for ax in axes) == 8
    assert "not drawn: foot4, foot5" in [ax.get_xlabel() for ax in axes]


def test_the_path_is_drawn_in_its_plane():
    def turned(i):
        return np.array([0.5, 0.1 * np.sin(i / 30), 0.2 * np.cos(i / 30)])

    log = make_log(**{"draw.desired": turned, "draw.position": turned})
    for name, title in ((make_log(), "path along x, y [mm]"), (log, "path along y, z [mm]")):
        assert panels(figure(name, make_summary(log)))["path"].get_title(loc="left") == title
    desired, actual, _ = panels(figure(log, make_summary(log)))["path"].lines
    assert actual.get_xdata() == pytest.approx(1e3 * log["draw.position"][:, 1])
    assert desired.get_ydata() == pytest.approx(1e3 * log["draw.desired"][:, 2])


def test_tracking_errors_are_told_in_mm_and_mrad():
    log = make_log()
    ax = panels(figure(log, make_summary(log)))["tracking"]
    assert labels(ax) == ["draw.position: rms 1 mm", "draw.rotation: rms 2 mrad"]
    assert ax.get_yscale() == "log"


def test_what_a_run_lacks_leaves_its_place_to_the_others():
    log = make_log(motions=())
    axes = panels(figure(log, make_summary(log)))
    assert not {"path", "tracking"} & set(axes)
    full = panels(figure(make_log(), make_summary(log)))
    assert axes["torques"].get_position().width > 1.5 * full["torques"].get_position().width


def test_a_push_stands_above_the_way_that_is_given_to_it():
    quantities = {"external": np.array([4.0, 0.1]), "displacement": np.array([0.02, 0.3])}
    more = {f"feel.{name}": lambda i, value=value: value for name, value in quantities.items()}
    more["upright.error"] = lambda i: np.array([2e-3, 0, 0, 0, 0, 0])
    log = make_log(contacts={}, motions=("feel", "upright"), **more)
    log.meta["pushed"] = {"feel": ["vx", "wz"]}
    found = panels(figure(log, make_summary(log)))
    push, way = found["feel pushed by [N]"], found["feel gives way [mm]"]
    assert labels(push) == ["x"]  # a moment has no place beside it
    assert push.lines[0].get_ydata()[0] == 4.0
    assert way.lines[0].get_ydata()[0] == 20.0
    assert labels(found["path"]) == ["desired", "actual"]  # what only turns has no path
    told = labels(found["tracking"])
    assert told[0].startswith("feel gives way: rms")
    assert not [text for text in told if text.startswith("upright.position")]


def test_torques_are_shares_of_limits_that_change_with_the_phase():
    weak = make_log(tau_max=lambda i: np.full(7, 25.0 if i >= 100 else 50.0), tau_min=lambda i: np.full(7, -100.0))
    ax = panels(figure(weak, make_summary(weak)))["torques"]
    joints, (low, high) = ax.lines[:7], ax.lines[7:]
    assert labels(ax)[0] == "joint1  40%"
    assert labels(ax)[-1] == "limit"
    assert max(joints[0].get_ydata()) == pytest.approx(0.4)
    assert min(joints[0].get_ydata()) == pytest.approx(-0.2, abs=1e-3)
    assert low.get_ydata() == pytest.approx(-1.0)
    assert high.get_ydata() == pytest.approx(np.where(np.arange(200) < 100, 1.0, 0.5))


def test_of_many_joints_the_hardest_working_are_named():
    log = make_log(joints=29, tau=lambda i: np.linspace(1.0, 29.0, 29))
    told = labels(panels(figure(log, make_summary(log)))["torques"])
    assert told == ["21 others", *(f"joint{i}  {i / 50:.0%}" for i in range(22, 30)), "limit"]


def test_status_and_active_limits_over_time():
    log = make_log(status=lambda i: 1 if i < 5 else 3 if i >= 190 else 0)
    log.active[:5] = [("torque[joint2]", "friction[foot]")] * 3 + [("torque[joint2]",)] * 2
    axes = panels(figure(log, make_summary(log)))
    assert labels(axes["status"]) == ["OK 185", "LIMITED 5", "SAFE_HOLD 10"]
    bars = [bar.get_paths()[0].get_extents() for bar in axes["status"].collections]
    assert [(bar.x0, bar.x1) for bar in bars] == [pytest.approx(x) for x in ((0.005, 0.19), (0, 0.005), (0.19, 0.2))]
    assert [text.get_text() for text in axes["active"].texts][:2] == ["torque[joint2]   5", "friction[foot]   3"]


def test_phases_stand_side_by_side_and_their_changes_on_every_time_axis():
    changes = [("approach", 0.0), ("write", 0.05), ("leave", 0.19)]
    log = make_log(**{"board.target": absent(50, 3)})
    log.meta["changes"] = [{"name": name, "start": start, "why": ""} for name, start in changes]
    axes = panels(figure(log, make_summary(log)))
    strip = axes["phases"]
    assert [text.get_text() for text in strip.texts] == ["approach", "write", "le…"]  # as long as there is room
    spans = [(span.get_x(), span.get_x() + span.get_width()) for span in strip.patches[1:]]
    assert spans == [pytest.approx(ends) for ends in ((0, 0.05), (0.05, 0.19), (0.19, 0.2))]
    for name in ("board [N]", "board error [N]", "torques", "tracking", "status", "active"):
        marked = {line.get_xdata()[0] for line in axes[name].lines if list(line.get_ydata()) == [0, 1]}
        assert {0.05, 0.19} <= marked, name
    # the settling of a contact is shaded from where it begins
    assert [(span.get_x(), span.get_width()) for span in axes["board [N]"].patches] == [pytest.approx((0.05, 0.05))]
    assert [(span.get_x(), span.get_width()) for span in axes["torques"].patches] == [pytest.approx((0.0, 0.05))]
    assert "phases" not in panels(figure(make_log(), make_summary(log)))


def test_limits_beyond_the_rows_are_counted():
    log = make_log(5)
    log.active[2] = tuple(f"torque[joint{i}]" for i in range(11))
    raster = panels(figure(log, make_summary(log)))["active"]
    assert len(raster.collections) == 8
    assert "and 3 more" in texts(raster)
    assert "no limit was active" in texts(panels(figure(make_log(5), make_summary(log)))["active"])


def test_tick_times_beside_the_control_period():
    log = make_log(step_us=lambda i: 2000.0 if i < 10 else 400.0)
    assert labels(panels(figure(log, make_summary(log)))["times"]) == [
        "p50 400",
        "p99 2000, max 2000",
        "period 1000: 5.00% over",
    ]


def test_a_long_run_keeps_its_extremes():
    log = make_log(9000, **{"board.lam": lambda i: np.array([0.0, 0.0, 7.0 if i == 4321 else -10.0])})
    drawn = panels(figure(log, make_summary(log)))["board [N]"].lines[0].get_ydata()
    assert len(drawn) <= 4002
    assert max(drawn) == 7.0
