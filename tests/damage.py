"""Plain data with one defect, for the tests of readers of stored files."""

import copy
import random

WRONG = (None, True, -3, 1e300, "x", "", [], {}, [1], ["a"], {"a": 1}, [[None]])


def places(data, path=()):
    """Return the paths to all values in nested objects and lists, for lists to the first two."""
    yield path
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places(value, (*path, key))
    elif isinstance(data, list):
        for number, value in enumerate(data[:2]):
            yield from places(value, (*path, number))


def damages(data, seed):
    """Yield, for each place, a description of the defect and the damaged data."""
    chance = random.Random(seed)
    for path in places(data):
        damaged = copy.deepcopy(data)
        if not path:
            yield "all of it", chance.choice(([], 3, "x", None))
            continue
        holder = damaged
        for part in path[:-1]:
            holder = holder[part]
        how = chance.choice(("dropped", "added to", "replaced"))
        if how == "dropped":
            del holder[path[-1]]
        elif how == "added to" and isinstance(holder[path[-1]], dict):
            holder[path[-1]]["unknown"] = 1
        else:
            holder[path[-1]] = chance.choice(WRONG)
        yield f"{'.'.join(map(str, path))} {how}", damaged
