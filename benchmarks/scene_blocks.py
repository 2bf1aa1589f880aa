"""Which scenes of the wiping level are for what: none is scored that something was chosen on.

A block is ``range(first, first + 10_000)`` or wider. Blocks below 40,000 are for development,
50,000 to 89,999 were used before this table existed. A block of final scenes is scored once; every
later run takes a new one.
"""

BLOCKS: dict[str, range] = {
    "demonstrations": range(0, 10_000),
    "README path": range(10_000, 20_000),  # scored again with every release: no claim rests on it
    "development": range(20_000, 26_000),
    "grip held": range(26_000, 26_200),  # development too, but nothing was chosen on it
    "reading expert": range(27_000, 28_000),  # development
    "dropped tool": range(28_000, 29_000),  # development
    "shear scale": range(29_000, 30_000),  # development
    "what scripts of the gates learn from": range(30_000, 40_000),
    "spent": range(50_000, 90_000),  # donors, a former leak check, descriptor heads, trials
    "gates": range(1_000_000, 1_010_000),
    "swap ladder": range(1_010_000, 1_020_000),
    "arms": range(1_020_000, 1_030_000),
    "controls": range(1_030_000, 1_040_000),
    "is touch needed": range(1_070_000, 1_080_000),
    "kinds left out": range(1_060_000, 1_070_000),
    "kinds left out, felt in newtons": range(1_080_000, 1_090_000),
    "spent on maps fitted to tools alone, which buy nothing": range(1_090_000, 1_100_000),
    "units weighed": range(1_100_000, 1_110_000),
    "swap ladder in the hand's rig": range(1_110_000, 1_120_000),
    "arms in the hand's rig": range(1_120_000, 1_130_000),
    "curves": range(1_130_000, 1_140_000),
    "stress, seen while a limit of the monitor was set": range(1_040_000, 1_041_000),
    "stress": range(1_041_000, 1_060_000),
}
