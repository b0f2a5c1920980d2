"""Arguments of a program whose work is done by the engine."""

from __future__ import annotations

import argparse

from calibration_core.engine.command_line import path


def cluster_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--cluster` and `--tls`."""
    parser.add_argument(
        "--cluster", default="", metavar="ADDRESS", help="a Dask scheduler, tcp:// or tls:// (default: this machine)"
    )
    parser.add_argument(
        "--tls",
        type=path,
        nargs=3,
        metavar=("CA", "CERTIFICATE", "KEY"),
        help="PEM files for a tls:// scheduler (default: as Dask is configured)",
    )
