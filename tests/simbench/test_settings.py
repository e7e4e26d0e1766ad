"""--set STAGE.FIELD=VALUE, and systems by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import pytest

from simbench.errors import BadFile, UnknownName, UserError
from simbench.load_system import load_system
from simbench.sensors.spec import find_sensor
from simbench.settings import with_settings
from synthetic import CAMERA


@dataclass(frozen=True, slots=True)
class Stage:
    sigma_px: float = 0.3
    count: int = 4
    enabled: bool = True
    kind: Literal["huber", "cauchy"] = "huber"
    limit: float | None = None
    name: str = "a"
    pair: tuple[int, int] = (1, 2)

    def __post_init__(self) -> None:
        if self.sigma_px == 0:
            raise ValueError("sigma_px must not be 0")


@dataclass(frozen=True, slots=True)
class Config:
    motion: Stage = field(default_factory=Stage)
    depth: float = 1.0


@pytest.mark.parametrize(("text", "name", "value"), [
    ("motion.sigma_px=1e-3", "sigma_px", 1e-3), ("motion.count=7", "count", 7),
    ("motion.enabled=false", "enabled", False), ("motion.enabled=Yes", "enabled", True),
    ("motion.kind=cauchy", "kind", "cauchy"), ("motion.limit=2", "limit", 2.0),
    ("motion.limit=none", "limit", None), ("motion.limit=inf", "limit", float("inf")),
    ("motion.name=x=y", "name", "x=y")])
def test_text_becomes_the_fields_type(text, name, value):
    changed = getattr(with_settings(Config(), [text]).motion, name)
    assert changed == value
    assert type(changed) is type(value)


def test_masks_may_grow():
    assert find_sensor("gaussian", {"masks.erosion_px": -4}).masks.erosion_px == -4
    with pytest.raises(UserError, match="must not be negative"):
        find_sensor("gaussian", {"depth.sigma_m_at_1m": -1})


def test_the_rest_stays_and_the_last_wins():
    changed = with_settings(Config(), ["motion.count=7", "depth=2", "motion.count=8"])
    assert changed == Config(Stage(count=8), 2.0)
    assert with_settings(Config(), []) == Config()


@pytest.mark.parametrize(("text", "kind", "says"), [
    ("moton.count=1", UnknownName, "did you mean 'motion'"),
    ("motion.cuont=1", UnknownName, "did you mean 'count'"),
    ("depth.count=1", UnknownName, "no fields of its own"),
    ("motion=1", UserError, "is a stage; set one of motion.sigma_px"),
    ("motion.count", UserError, "wanted STAGE.FIELD=VALUE"),
    ("motion.count=1.5", UserError, "not a whole number"),
    ("motion.sigma_px=much", UserError, "not a number"),
    ("motion.enabled=maybe", UserError, "true or false"),
    ("motion.kind=tukey", UserError, "one of huber, cauchy"),
    ("motion.pair=1", UserError, "cannot be set"),
    ("motion.sigma_px=0", UserError, "sigma_px must not be 0"),
    ("motion.sigma_px=-1", UserError, "must not be negative; wanted a number from 0"),
    ("motion.sigma_px=nan", UserError, "wanted a number from 0"),
    ("motion.count=-1", UserError, "wanted a whole number from 0"),
    ("motion.limit=-2", UserError, "must not be negative")])
def test_what_cannot_be_set_is_refused_in_one_line(text, kind, says):
    with pytest.raises(kind, match=says) as raised:
        with_settings(Config(), [text])
    assert "\n" not in str(raised.value)


def test_a_preset_takes_settings_and_shows_them_resolved():
    system, resolved = load_system("sdpl", CAMERA, ["motion.optimise_flow=false"])
    assert callable(system.process)
    assert resolved["motion"]["optimise_flow"] is False


def test_a_preset_with_a_batch_takes_settings_of_its_back_end():
    system, resolved = load_system("sdpl-batch", CAMERA, ["backend.window.frames=10",
                                                          "backend.formulation=paper",
                                                          "backend.bundle.line_form=paper"])
    assert system.backend.window.frames == 10
    assert resolved["backend"]["window"]["frames"] == 10
    assert resolved["backend"]["formulation"] == "paper"
    assert system.backend.bundle.line_form == "paper"


@pytest.mark.parametrize(("preset", "text", "says"), [
    ("sdpl-batch", "backend.window.length=10", "There are enabled, frames"),
    ("sdpl-batch", "window.frames=10", "did you mean 'backend.window'"),
    ("sdpl-batch", "backend.windw.frames=10", "did you mean 'window'"),
    ("sdpl", "backend.window.frames=10", "no setting 'backend'")])
def test_a_wrong_name_of_the_back_end_is_refused(preset, text, says):
    with pytest.raises(UnknownName, match=says):
        load_system(preset, CAMERA, [text])


def test_a_factory_from_a_file_and_from_a_module(tmp_path, monkeypatch):
    source = ("class S:\n    def __init__(self, i): self.i = i\n"
              "    def process(self, frame): ...\n    def finish(self): ...\n"
              "def make(intrinsics): return S(intrinsics)\n"
              "def none(intrinsics): return 3\ndef fails(intrinsics): raise KeyError('gpu')\n")
    (tmp_path / "their_slam.py").write_text(source)
    monkeypatch.chdir(tmp_path)
    for name in ("their_slam.py:make", "their_slam:make"):
        system, resolved = load_system(name, CAMERA)
        assert system.i is CAMERA
        assert resolved == {}
    with pytest.raises(UserError, match="wanted an object with process and finish"):
        load_system("their_slam:none", CAMERA)
    with pytest.raises(UserError, match="raised KeyError: 'gpu'"):
        load_system("their_slam:fails", CAMERA)
    with pytest.raises(UnknownName, match="did you mean 'make'"):
        load_system("their_slam:mke", CAMERA)
    with pytest.raises(UserError, match="settings of their_slam:make are its own"):
        load_system("their_slam:make", CAMERA, ["a.b=1"])


def test_unknown_systems_are_refused(tmp_path):
    with pytest.raises(UnknownName, match="did you mean 'sdpl'"):
        load_system("sdlp", CAMERA)
    with pytest.raises(UnknownName, match="No module named 'no_such_package'"):
        load_system("no_such_package.slam:make", CAMERA)
    with pytest.raises(BadFile, match=r"gone\.py: no such file"):
        load_system(f"{tmp_path}/gone.py:make", CAMERA)
    broken = tmp_path / "broken.py"
    broken.write_text("def make(:\n")
    with pytest.raises(UserError, match="raised SyntaxError"):
        load_system(f"{broken}:make", CAMERA)
