"""``monoloc bench``: the speed of monoloc on this machine, compared with alternatives in the same run."""
