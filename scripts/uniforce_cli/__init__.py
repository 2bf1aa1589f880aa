"""All commands: a config dataclass and a ``main`` each. No other package imports them."""
