"""The built-in instances by name; each name ends with the number of its items."""

BUILTIN_NAMES = (
    "polytopes-20",
    "polytopes-60",
    "brackets-24",
    "gears-12",
    "rings-12",
    "cuboids-16",
    "cut-cube-8",
    "cut-cube-16",
)
