"""Jobs over the logs of many machines, and questions to what comes of them.

A :class:`Manifest` names machines and logs, :func:`run` does a job for each log on an engine (Ray, or processes of this machine), and leaves a
partitioned Parquet data set; :func:`pooled` and :func:`report` ask it. The command ``seepd fleet`` is the same. ``docs/fleet.md`` has the
manual and the tables' columns.
"""

from __future__ import annotations

from .manifest import Machine, Manifest
from .pooled import PooledEffect, pooled
from .report import report
from .runner import Outcome, Settings, run

__all__ = ["Machine", "Manifest", "Outcome", "PooledEffect", "Settings", "pooled", "report", "run"]
