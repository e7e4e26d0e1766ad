"""The two renderers against each other."""

import numpy as np
import pytest

from ray_oracle import near_part_borders, near_steps
from simbench.errors import UserError
from simbench.render import make_renderer
from simbench.scene import SceneSpec, list_scenes
from simbench.world import make_world


@pytest.mark.parametrize("name", ["MarkerRoom-v0", *(spec.name for spec in list_scenes())])
def test_both_renderers_agree_on_parts_and_depth(name, marker_spec):
    """Parts on 99.9 % of pixels; depth within what pyrender's 24-bit z-buffer can tell."""
    pytest.importorskip("pyrender")
    world = make_world(marker_spec if name == "MarkerRoom-v0" else name)
    first, second = make_renderer("mujoco", world), make_renderer("pyrender", world)
    near = world.model.vis.map.znear * world.model.stat.extent
    for time_s in (0.0, 0.8):
        world.advance_to(time_s)
        depth, part = first.depth_and_parts(world)
        other_depth, other_part = second.depth_and_parts(world)
        differs = part != other_part
        assert differs.mean() <= 1e-3
        assert near_part_borders(part)[differs].all()
        clear = ~differs & (part >= 0) & ~near_steps(depth)
        allowed = 1e-4 * np.maximum(1.0, depth) + depth**2 / near * 2.0**-21
        assert (np.abs(depth - other_depth) <= allowed)[clear].mean() > 0.999
        assert second.rgb(world).std() > 10.0
    second.close()
    first.close()


def test_pyrender_names_a_geom_that_it_cannot_draw(tmp_path):
    pytest.importorskip("pyrender")
    (tmp_path / "ball.xml").write_text(
        '<mujoco><worldbody><geom name="ball" type="sphere" size=".5"/>'
        '<camera name="camera" pos="0 0 3"/></worldbody></mujoco>')
    world = make_world(SceneSpec(name="Ball-v0", description="a ball", mjcf=tmp_path / "ball.xml",
                                 motion=lambda time_s, seed, dials: {}, width=64, height=48))
    with pytest.raises(UserError, match="'ball'"):
        make_renderer("pyrender", world)
