"""Many items by one compiled program on several devices: an equal share for each.

Each device computes its share by itself: an item that takes more steps holds up none of the others.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ._program import program

_AXIS = "item"


def over_devices(
    function: Callable[..., Any], items: Any, shared: tuple[Any, ...], batch_size: int | None
) -> Any:
    """As `giajax.map_on_cores`, over all devices of this process.

    Arguments:
        function, items, shared, batch_size: as there.

    Returns:
        Arrays that lie on the devices, as their items do; the last item is there as often as it
        takes to make all shares equally long.
    """
    mesh = Mesh(np.asarray(jax.local_devices()), (_AXIS,))
    count = len(jax.tree.leaves(items)[0])
    rows = np.minimum(np.arange(count + -count % mesh.size), count - 1)
    items = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], items)
    items = jax.device_put(items, NamedSharding(mesh, PartitionSpec(_AXIS)))
    numbers, rest = eqx.partition((function, shared), eqx.is_array)
    numbers = jax.device_put(numbers, NamedSharding(mesh, PartitionSpec()))
    return _shared_out(items, numbers, rest, batch_size, mesh)


@program
def _shared_out(items: Any, numbers: Any, rest: Any, batch_size: int | None, mesh: Mesh) -> Any:
    def part(items: Any, numbers: Any) -> Any:
        function, shared = eqx.combine(numbers, rest)
        return jax.lax.map(lambda item: function(item, *shared), items, batch_size=batch_size)

    specs = (PartitionSpec(_AXIS), PartitionSpec())
    return jax.shard_map(
        part, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(_AXIS), check_vma=False
    )(items, numbers)
