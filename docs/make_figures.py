"""Draw the pictures of the documentation: runs the scenes, keeps their numbers, draws.

Writes `docs/figures/*.png` and, beside them, the small tables that they are drawn from. With
`--redraw` it draws from the tables that are there and runs nothing. Names choose figures. Each
page of the documentation has its `figures_*.py`.
"""

import argparse

import figures_bands
import figures_biaxial
import figures_guo_zhao
import figures_laboratory
import figures_localisation
import figures_operators
import figures_softening
import figures_tradeoff
from figures_common import FIGURES

#: What runs and what draws, by name.
ALL = {
    **figures_tradeoff.ALL,
    **figures_biaxial.ALL,
    **figures_operators.ALL,
    **figures_laboratory.ALL,
    **figures_softening.ALL,
    **figures_bands.ALL,
    **figures_localisation.ALL,
    **figures_guo_zhao.ALL,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"{', '.join(ALL)} (default: all)")
    parser.add_argument("--redraw", action="store_true", help="run nothing")
    args = parser.parse_args()
    unknown = set(args.names) - set(ALL)
    if unknown:
        parser.error(f"unknown figure {', '.join(sorted(unknown))}; choose from {', '.join(ALL)}")
    FIGURES.mkdir(parents=True, exist_ok=True)
    for name in args.names or ALL:
        print(name, flush=True)
        run, draw = ALL[name]
        if not args.redraw:
            run()
        draw()


if __name__ == "__main__":
    main()
