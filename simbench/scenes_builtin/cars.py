"""Cars as flat-faced meshes: a body lofted along its length, windows, lamps, doors and wheels."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.meshes import MeshBuilder, visible_geom
from simbench.randomise import hue_rgba, set_texture
from simbench.scenes_builtin.bodies import make_weightless
from slam.geometry.arrays import Array

_WHEEL_SIDES = 28
_ARCH_M = 0.07          # room between tyre and arch
_PANEL_M = 0.014        # by which doors stand out of the body
_DOOR_OPEN_RAD = np.deg2rad(65.0)
_PAINT_TILES = 0.42     # texture tiles per metre


@dataclass(frozen=True, slots=True)
class CarShape:
    """A car's outline as piecewise linear functions of x (m, forward, 0 in the middle)."""

    name: str
    belt: tuple[tuple[float, float], ...]     # (x, z) of the lower edge of the windows
    top: tuple[tuple[float, float], ...]      # (x, z) of the centre line
    side_glass: tuple[tuple[float, float], ...]   # stretches of x with side windows
    end_glass: tuple[tuple[float, float], ...]    # stretches of x of the windscreens
    door: tuple[float, float]                 # x from rear to front edge
    axles: tuple[float, float]                # x, rear and front
    half_width: float = 0.86
    roof_half_width: float = 0.60
    wheel_radius: float = 0.32
    sill: float = 0.25

    @property
    def length(self) -> float:
        return self.top[-1][0] - self.top[0][0]


SHAPES = (
    CarShape("sedan",
             belt=((-2.25, 0.80), (-2.1, 0.93), (-1.5, 0.95), (1.0, 0.92), (2.05, 0.74),
                   (2.25, 0.60)),
             top=((-2.25, 0.84), (-2.1, 0.97), (-1.6, 1.00), (-0.85, 1.40), (0.15, 1.44),
                  (1.0, 0.98), (2.05, 0.79), (2.25, 0.64)),
             side_glass=((-1.0, -0.28), (-0.18, 0.55)), end_glass=((-1.5, -0.92), (0.24, 0.94)),
             door=(-0.22, 0.80), axles=(-1.32, 1.36)),
    CarShape("hatchback",
             belt=((-1.95, 0.86), (-1.85, 0.96), (0.95, 0.93), (1.8, 0.78), (1.98, 0.64)),
             top=((-1.95, 0.90), (-1.85, 1.02), (-1.35, 1.46), (0.10, 1.50), (0.95, 0.99),
                  (1.8, 0.83), (1.98, 0.68)),
             side_glass=((-1.25, -0.42), (-0.32, 0.48)), end_glass=((-1.78, -1.42), (0.2, 0.88)),
             door=(-0.36, 0.72), axles=(-1.2, 1.22)),
    CarShape("van",
             belt=((-2.3, 1.05), (1.35, 1.05), (2.1, 0.92), (2.3, 0.72)),
             top=((-2.3, 1.86), (-2.2, 1.94), (0.75, 1.95), (1.45, 1.13), (2.1, 0.98),
                  (2.3, 0.77)),
             side_glass=((0.05, 0.85),), end_glass=((0.82, 1.38),),
             door=(0.0, 1.02), axles=(-1.4, 1.42), half_width=0.90, roof_half_width=0.80),
)


@dataclass(frozen=True, slots=True)
class CarLook:
    """What tells one car of a shape from another."""

    shape: CarShape
    paint: str          # material


def draw_look(spec: mujoco.MjSpec, rng: np.random.Generator, name: str,
              shapes: tuple[CarShape, ...] = SHAPES) -> CarLook:
    """A shape and a paint for the car `name`."""
    shape = shapes[int(rng.integers(len(shapes)))]
    rgba = hue_rgba(rng.uniform(), rng.choice([0.05, 0.55, 0.75]), rng.uniform(0.55, 1.0))
    material = spec.add_material(name=f"{name} paint", rgba=rgba, specular=0.2, shininess=0.3)
    set_texture(material, "paint")
    return CarLook(shape, material.name)


def add_all_car_meshes(spec: mujoco.MjSpec, flaps: bool) -> None:
    """The meshes of every shape, for `add_car` to show; `flaps`: doors and tailgates apart."""
    for shape in SHAPES:
        _add_car_meshes(spec, shape, flaps)


def _add_car_meshes(spec: mujoco.MjSpec, shape: CarShape, flaps: bool) -> None:
    """Put the meshes that all cars of the shape share into `spec`."""
    painted, glass, trim = _hull(shape)
    lamps, tails = MeshBuilder(), MeshBuilder()
    rear, front = shape.top[0][0], shape.top[-1][0]
    low = shape.belt[-1][1]
    for side in (-1.0, 1.0):
        y = side * (shape.half_width - 0.24)
        lamps.box((front - 0.02, y, low - 0.06), (0.10, 0.30, 0.13))
        tails.box((rear, side * (shape.half_width - 0.16), shape.belt[0][1] - 0.14),
                  (0.06, 0.20, 0.22))
        trim.box((shape.door[1] - 0.05, side * (shape.half_width + 0.07), shape.belt[-2][1] + 0.20),
                 (0.12, 0.20, 0.13))
    for x, reach in ((front, 0.05), (rear, -0.05)):
        trim.box((x + reach / 2.0, 0.0, 0.41), (0.16, 2.0 * shape.half_width - 0.06, 0.17))
        lamps.box((x + reach * 2.0, 0.0, 0.42), (0.04, 0.46, 0.11))
    trim.box((front - 0.01, 0.0, low - 0.07), (0.08, 0.9, 0.10))
    for part, builder in (("glass", glass), ("trim", trim), ("lamps", lamps), ("tails", tails)):
        builder.add_to(spec, f"{shape.name} {part}")
    if flaps:
        painted.add_to(spec, f"{shape.name} hull", smooth=True)
    for name, panel in _panels(shape).items():
        if flaps:
            panel.add_to(spec, f"{shape.name} {name}")
        painted.merge(panel)
    painted.add_to(spec, f"{shape.name} closed hull", smooth=True)
    wheel, wheels = _wheel(shape.wheel_radius), MeshBuilder()
    for place in _wheel_places(shape):
        wheels.merge(wheel, place)
    wheel.add_to(spec, f"{shape.name} wheel")
    wheels.add_to(spec, f"{shape.name} wheels")


def add_car(spec: mujoco.MjSpec, name: str, look: CarLook, flaps: bool, rolls: bool
            ) -> mujoco.MjsBody:
    """A car as a child of the world: x forward, the origin on the ground below its middle.

    With `rolls` the wheels are bodies with hinges "<name> wheel 0" to 3; with `flaps` doors and
    tailgate are bodies with hinges "<name> left door", "... right door", "... tailgate".
    """
    shape = look.shape
    car = spec.worldbody.add_body(name=name)
    visible_geom(car, f"{shape.name} {'hull' if flaps else 'closed hull'}", look.paint)
    for part in ("glass", "trim", "lamp", "tail"):
        mesh = part if part in ("glass", "trim") else f"{part}s"
        visible_geom(car, f"{shape.name} {mesh}", f"car {part}")
    rear = shape.top[0][0]
    hinges = {"left door": ([shape.door[1], shape.half_width, 0.0], [0.0, 0.0, -1.0]),
              "right door": ([shape.door[1], -shape.half_width, 0.0], [0.0, 0.0, 1.0]),
              "tailgate": ([rear, 0.0, shape.belt[0][1] - 0.02], [0.0, 1.0, 0.0])}
    if flaps:
        for panel, (place, axis) in hinges.items():
            body = _jointed(car, f"{name} {panel}", place, axis)
            visible_geom(body, f"{shape.name} {panel}", look.paint)
    if not rolls:
        visible_geom(car, f"{shape.name} wheels", "wheel")
        return car
    for number, place in enumerate(_wheel_places(shape)):
        body = _jointed(car, f"{name} wheel {number}", [0.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        body.pos = place
        visible_geom(body, f"{shape.name} wheel", "wheel")
    return car


def flap_angles(name: str, share: Array) -> dict[str, float]:
    """Joint positions of the doors and the tailgate, opened by `share` (3,) of their way."""
    angle = _DOOR_OPEN_RAD * share
    return {f"{name} left door": float(angle[0]), f"{name} right door": float(angle[1]),
            f"{name} tailgate": float(angle[2])}


def _wheel_places(shape: CarShape) -> list[list[float]]:
    return [[x, side * (shape.half_width - 0.10), shape.wheel_radius]
            for x in shape.axles for side in (-1.0, 1.0)]


def _jointed(parent: mujoco.MjsBody, name: str, place: list[float], axis: list[float]
             ) -> mujoco.MjsBody:
    body = parent.add_body(name=name)
    make_weightless(body)
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, pos=place, axis=axis)
    return body


def _hull(shape: CarShape) -> tuple[MeshBuilder, MeshBuilder, MeshBuilder]:
    """Painted body, glass and underside, lofted over stations along x."""
    x = _stations(shape)
    bottom = np.full_like(x, shape.sill)
    arch = shape.wheel_radius + _ARCH_M
    for axle in shape.axles:
        rise = np.sqrt(np.clip(arch**2 - (x - axle) ** 2, 0.0, None))
        bottom = np.maximum(bottom, np.where(rise > 0, shape.wheel_radius + rise, 0.0))
    belt = np.interp(x, *np.transpose(shape.belt))
    top = np.interp(x, *np.transpose(shape.top))
    # Where there is no cabin the "roof" is the bonnet, nearly as wide as the car.
    cabin = np.clip((top - belt - 0.05) / 0.35, 0.0, 1.0)
    nose = np.clip((np.abs(x) - (shape.length / 2.0 - 0.25)) / 0.25, 0.0, 1.0) * 0.08
    width = shape.half_width - nose
    w_belt = width - 0.02
    w_top = w_belt - 0.10 + cabin * (shape.roof_half_width - shape.half_width + 0.12)
    rim = [(width, bottom), (w_belt, belt)]
    rim += [(w_belt + s * (w_top - w_belt), belt + s * (top - belt)) for s in (0.10, 0.85, 1.0)]
    rim += [(0.88 * w_top, top)]
    left = np.stack([np.stack([x, w, z], axis=-1) for w, z in rim])         # (6, S, 3)
    painted, glass, trim = MeshBuilder(), MeshBuilder(), MeshBuilder()
    mirror = np.array([1.0, -1.0, 1.0])
    middle = 0.5 * (x[1:] + x[:-1])
    windows = _within(middle, shape.side_glass)
    screens = _within(middle, shape.end_glass)
    for level in range(5):
        quad = np.stack([left[level, 1:], left[level, :-1], left[level + 1, :-1],
                         left[level + 1, 1:]], axis=1)
        both = [quad, (quad * mirror)[:, ::-1]]
        is_glass = windows if level == 2 else np.zeros_like(windows)
        for side in both:
            painted.quads(side[~is_glass], scale=_PAINT_TILES)
            glass.quads(side[is_glass], scale=0.8)
    roof = np.stack([left[5, :-1] * mirror, left[5, 1:] * mirror, left[5, 1:], left[5, :-1]], 1)
    painted.quads(roof[~screens], scale=_PAINT_TILES)
    glass.quads(roof[screens], scale=0.8)
    trim.quads(np.stack([left[0, :-1], left[0, 1:], left[0, 1:] * mirror, left[0, :-1] * mirror],
                        axis=1))
    for end, flip in ((0, False), (-1, True)):
        levels = left[[0, 1, 4], end]
        for a, b in ((0, 1), (1, 2)):
            quad = np.stack([levels[a], levels[a] * mirror, levels[b] * mirror, levels[b]])
            painted.quads(quad[::-1] if flip else quad, scale=_PAINT_TILES)
    return painted, glass, trim


def _stations(shape: CarShape) -> Array:
    """Where the outline bends: corners, window ends and points of the wheel arches."""
    bends = [x for x, _ in (*shape.belt, *shape.top)]
    bends += [x for stretch in (*shape.side_glass, *shape.end_glass) for x in stretch]
    arch = (shape.wheel_radius + _ARCH_M) * np.cos(np.linspace(0.0, np.pi, 9))
    stations = np.unique(np.round([*bends, *(a + x for a in shape.axles for x in arch)], 4))
    return np.asarray(stations[np.concatenate([[True], np.diff(stations) > 0.004])])


def _within(x: Array, stretches: tuple[tuple[float, float], ...]) -> Array:
    return np.any([(x > low) & (x < high) for low, high in stretches], axis=0)


def _panels(shape: CarShape) -> dict[str, MeshBuilder]:
    """Doors and tailgate: thin slabs that stand out of the body by a little."""
    x0, x1 = shape.door
    z0, z1 = shape.sill + 0.08, float(np.interp((x0 + x1) / 2.0, *np.transpose(shape.belt))) - 0.05
    thick = 0.03
    panels = {name: MeshBuilder() for name in ("left door", "right door", "tailgate")}
    for name, side in (("left door", 1.0), ("right door", -1.0)):
        y = side * (shape.half_width + _PANEL_M - thick / 2.0)
        panels[name].box(((x0 + x1) / 2.0, y, (z0 + z1) / 2.0), (x1 - x0, thick, z1 - z0),
                         scale=_PAINT_TILES, shift=(0.3, 0.2))
        panels[name].box((x0 + 0.14, y + side * 0.02, z1 - 0.10), (0.16, 0.03, 0.035))
    rear, top = shape.top[0][0], shape.belt[0][1] - 0.03
    panels["tailgate"].box((rear - _PANEL_M + thick / 2.0, 0.0, (0.55 + top) / 2.0),
                           (thick, 1.15, top - 0.55), scale=_PAINT_TILES, shift=(0.6, 0.5))
    return panels


def _wheel(radius: float, width: float = 0.22) -> MeshBuilder:
    """A wheel about the y axis; the texture has rim and tyre on one tile as wide as the wheel."""
    angle = 2.0 * np.pi * np.arange(_WHEEL_SIDES + 1) / _WHEEL_SIDES
    ring = radius * np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    half = np.array([0.0, width / 2.0, 0.0])
    a, b = ring[:-1], ring[1:]
    builder = MeshBuilder()
    tread = np.stack([b + half, b - half, a - half, a + half], axis=1)
    tyre_uv = np.array([[0.48, 0.96], [0.48, 0.99], [0.52, 0.99], [0.52, 0.96]])
    builder.quads(tread, np.broadcast_to(tyre_uv, (len(tread), 4, 2)))
    for side in (1.0, -1.0):
        centre = np.broadcast_to(side * half, a.shape)
        first, second = (b, a) if side > 0 else (a, b)
        disc = np.stack([centre, first + side * half, second + side * half,
                         second + side * half], axis=1)
        builder.quads(disc, 0.5 + disc[..., [0, 2]] / (2.0 * radius))
    return builder
