"""Studies: many runs of a model, compared or spread over processes; most return a `Table`.

    def swing(point):                     # at the top level of a module or script
        trajectory = rs.simulate(model(), 2.0, params=point)
        return {"energy": trajectory["energy"][-1]}

    if __name__ == "__main__":
        table = rs.study.sweep(swing, [{"k": k} for k in (1e4, 2e4)], file="swing.jsonl")
        print(table.with_units({"k": "N/m", "energy": "J"}))

Where a sweep runs. By default it runs in one process for each core of this machine. They are
created with the start method 'spawn', since a fork of a process that uses CasADi or threads may
hang, so a script needs `if __name__ == "__main__":` around what it does. Any
`concurrent.futures.Executor` can be given instead; it is not shut down:

    ProcessPoolExecutor(4, multiprocessing.get_context("spawn"))
    dask.distributed.Client("scheduler:8786").get_executor()     # workers of one thread each
    mpi4py.futures.MPIPoolExecutor()

Threads do not make simulations faster: CasADi's messages are caught by redirecting `sys.stdout` of
the whole process, so only one simulation runs at a time.

What counts as a failure. A point whose function raises becomes a row with the reason; so does a
point during which one of our own processes died (another process takes its place). Both are kept in
the file. A failure of an executor that was given (lost workers, cancelled points) says nothing
about the point. It is an error in the table only, and the next call with the same file runs that
point again.
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
