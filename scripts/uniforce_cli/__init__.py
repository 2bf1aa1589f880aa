"""Every command: a config dataclass and a ``main`` each; they know all the rest, and nothing knows them."""
