"""``monoloc reproduce``: the figures and the table of the paper, and further ones, one file each."""
