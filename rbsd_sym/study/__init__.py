"""Studies: one question asked at many points, in parallel; they return a `Table`.

    def swing(point):                     # at the top level of a module or script
        trajectory = rs.simulate(model(), 2.0, params=point)
        return {"energy": trajectory["energy"][-1]}

    if __name__ == "__main__":
        table = rs.study.sweep(swing, [{"k": k} for k in (1e4, 2e4)], file="swing.jsonl")
        print(table.with_units({"k": "N/m", "energy": "J"}))

Where it runs. By default in processes of this machine, one for each core, made with the start
method 'spawn', since a fork of a process that uses CasADi or threads may hang. So a script needs
`if __name__ == "__main__":` round what it does. Any `concurrent.futures.Executor` may be handed in,
and is not shut down:

    ProcessPoolExecutor(4, multiprocessing.get_context("spawn"))
    dask.distributed.Client("scheduler:8786").get_executor()     # workers of one thread each
    mpi4py.futures.MPIPoolExecutor()

Threads gain nothing where functions simulate: CasADi's messages are caught by redirecting
`sys.stdout` for the whole process, so simulations take turns.

What a failure is. A point whose function raises is a row with its reason; so is a point during
which a process of our own died (another process takes over). Both are kept in the file. Trouble of
an executor handed in (lost workers, cancelled points) is an error in the table alone: it says
nothing about the point, and the next call with the same file runs that point again.
"""

from .contenders import contenders
from .domain import domain
from .recommend import Recommendation, recommend
from .stability_map import stability_map
from .sweep import sweep
from .table import ResultTable as Table
from .work_precision import Reference, converged, work_precision

__all__ = [
    "Recommendation",
    "Reference",
    "Table",
    "contenders",
    "converged",
    "domain",
    "recommend",
    "stability_map",
    "sweep",
    "work_precision",
]
