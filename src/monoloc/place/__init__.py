"""A place: several rooms, each a bundle, with doors between them."""
