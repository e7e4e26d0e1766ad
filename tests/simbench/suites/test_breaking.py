"""Breaking points: where they are known, what is said of them, and the command."""

import json

import numpy as np
import pytest

from simbench.cli import main
from simbench.errors import UserError
from simbench.scene import Dial
from simbench.suites.breaking import Limit, ends_of, held_dials, search

TEXTURE = Dial("texture", 1.0, 0.0, 1.0, "")
ERROR = Limit.parse("camera.E_t=0.002")


def errors_at(breaks, spread, calls):
    """Errors that pass 2 mm where texture falls below `breaks`, a little elsewhere in each seed."""
    seeds = spread * np.linspace(-1, 1, 5)

    def values_at(system, value):
        calls.append(value)
        return 0.002 * np.exp(3.0 * (breaks + seeds - value))

    return values_at


@pytest.mark.parametrize("breaks", [0.13, 0.5, 0.97])
def test_the_point_is_found_and_its_interval_holds_it(breaks):
    calls = []
    found, = search(errors_at(breaks, 0.05, calls), ["sdpl"], TEXTURE, (1.0, 0.0), ERROR)
    assert found.at == pytest.approx(breaks, abs=0.01)
    assert found.low < found.at < found.high
    assert 0.02 < found.high - found.low < 0.1
    assert found.holds_share == 0.0
    assert len(calls) == 7                       # two ends and five halvings
    text = found.statement("texture", ERROR, (1.0, 0.0), 5)
    assert "camera.E_t <= 0.002 m holds until texture" in text
    assert "95 % by 5 seeds" in text


def test_what_never_breaks_or_always_does_is_told():
    held, = search(errors_at(-1.0, 0.0, []), ["sdpl"], TEXTURE, (1.0, 0.0), ERROR)
    assert held.at is None
    assert held.holds_share == 1.0
    assert "holds from texture 1 to 0" in held.statement("texture", ERROR, (1.0, 0.0), 5)
    gone, = search(errors_at(2.0, 0.0, []), ["sdpl"], TEXTURE, (1.0, 0.0), ERROR)
    assert gone.at == 1.0
    assert "is broken at texture 1 already" in gone.statement("texture", ERROR, (1.0, 0.0), 5)


def test_a_system_without_any_value_is_broken_there():
    def values_at(system, value):
        return np.full(3, 0.001 if value <= 2 else np.nan)

    speed = Dial("objects", 1.0, 1.0, 9.0, "", integer=True)
    found, = search(values_at, ["sdpl"], speed, (1.0, 9.0), ERROR)
    assert 2.0 <= found.at <= 3.0
    assert [value for value, mean in found.visited if mean is None] == [3.0, 5.0, 9.0]


def test_limits_and_ends_are_checked():
    assert str(Limit.parse("camera.coverage=0.9")) == "camera.coverage >= 0.9"
    for wrong in ("camera.coverage", "camera.coverage=x", "camera.covarage=1", "=1"):
        with pytest.raises(UserError):
            Limit.parse(wrong)
    dial, first, last = ends_of("SwingingBoxes-v0", "camera_speed", None, None)
    assert (dial.name, first, last) == ("camera_speed", 1.0, 4.0)
    for arguments in (("tekture", None, None), ("texture", None, 2.0), ("texture", 0.5, 0.5)):
        with pytest.raises(UserError):
            ends_of("SwingingBoxes-v0", *arguments)


def test_held_dials_are_checked_as_the_scene_has_them():
    office = ("Office-v0", "texture")
    assert held_dials(*office, {"camera_motion": 2.0, "people": "visit", "speed": 1.5}) \
        == (("people", "visit"), ("camera_motion", "rpy"), ("speed", 1.5))
    for given, message in (({"texture": 0.5}, "is the dial that the search turns"),
                           ({"sped": 1.0}, "did you mean 'speed'"),
                           ({"speed": 9.0}, "must be a number from 0 to 2"),
                           ({"people": "dancing"}, "must be one of walking")):
        with pytest.raises(UserError, match=message):
            held_dials(*office, given)
    with pytest.raises(UserError, match="--with people=walking"):
        ends_of("Office-v0", "people", None, None)


def test_the_command_searches_and_writes_a_page(tmp_path, capsys, in_this_process):
    out = tmp_path / "out"
    options = ["--dial", "texture", "--systems", "sdpl", "--seeds", "0", "--frames", "3", "--size",
               "64x48", "--reports", "none", "--flow", "noisy", "--limit", "camera.E_t=1e-9",
               "--out", str(out)]
    assert main(["suite", "break", *options]) == 0
    assert "is broken at texture 1 already" in capsys.readouterr().out   # nothing is that exact
    answer = json.loads((out / "breaking.json").read_text())["breaking"]
    assert answer[0]["at"] == 1.0
    assert "is broken at texture 1 already" in (out / "report.html").read_text()
    assert main(["suite", "break", *options, "--resume"]) == 0


def test_searches_with_other_held_dials_share_a_folder_and_no_run(tmp_path, in_this_process):
    options = ["suite", "break", "--dial", "texture", "--seeds", "0", "--frames", "2", "--size",
               "64x48", "--reports", "none", "--flow", "truth", "--limit", "camera.E_t=1e-9",
               "--out", str(tmp_path)]
    paths = {}
    for speed in ("2", "3"):
        assert main([*options, "--with", f"speed={speed}", "--with", "objects=2", "--resume"]) == 0
        found = json.loads((tmp_path / "results.json").read_text())
        paths[speed] = {run["folder"] for run in found["runs"]}
        assert all(run["point"]["speed"] == float(speed) and run["point"]["objects"] == 2.0
                   for run in found["runs"])
        answer, = json.loads((tmp_path / "breaking.json").read_text())["breaking"]
        assert answer["with"] == {"speed": float(speed), "objects": 2.0}
        told = f"sdpl with speed={speed}, objects=2: camera.E_t"
        assert told in answer["statement"]
        assert told in (tmp_path / "report.html").read_text()
    assert not paths["2"] & paths["3"]
    assert all((tmp_path / path).is_dir() for path in paths["2"] | paths["3"])


@pytest.mark.parametrize(("given", "message"), [
    (["--with", "speed"], "--with speed: wanted NAME=VALUE"),
    (["--with", "speed="], "--with speed=: wanted NAME=VALUE"),
    (["--with", "speed=1", "--with", "speed=2"], "dial 'speed' is given twice"),
])
def test_what_is_held_is_said_once_and_whole(tmp_path, capsys, given, message):
    assert main(["suite", "break", "--dial", "texture", *given, "--out", str(tmp_path / "o")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_options_of_the_search_belong_to_it(tmp_path, capsys):
    assert main(["suite", "smoke", "--dial", "texture", "--out", str(tmp_path / "o")]) == 2
    assert "--dial: is for `simbench suite break`" in capsys.readouterr().err
    assert main(["suite", "smoke", "--with", "speed=1", "--out", str(tmp_path / "o")]) == 2
    assert "--with: is for `simbench suite break`" in capsys.readouterr().err
    assert main(["suite", "break", "--out", str(tmp_path / "o")]) == 2
    assert "which dial?" in capsys.readouterr().err
