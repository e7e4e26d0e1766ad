"""The scenes that come with simbench; importing this package registers them."""

from simbench.scenes_builtin import corridor as corridor
from simbench.scenes_builtin import loop as loop
from simbench.scenes_builtin import office as office
from simbench.scenes_builtin import street as street
from simbench.scenes_builtin import swinging_boxes as swinging_boxes
