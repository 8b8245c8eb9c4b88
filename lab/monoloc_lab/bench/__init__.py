"""How fast monoloc is here: its hot parts against what one would use in their place, in the same run."""
