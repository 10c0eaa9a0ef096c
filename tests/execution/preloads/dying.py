"""A worker that is killed as it begins a piece, by default its second, when it holds its first."""

import os
import signal


async def dask_setup(worker):
    from distributed import WorkerPlugin

    class Dying(WorkerPlugin):
        begun = 0

        def transition(self, key, start, finish, **kwargs):
            piece = isinstance(key, tuple) and str(key[0]).startswith("loopcal-")
            if piece and finish == "executing":
                self.begun += 1
                if self.begun == int(os.environ.get("DIES_AT_PIECE", "2")):
                    os.kill(os.getpid(), signal.SIGKILL)

    await worker.plugin_add(Dying(), name="dying")
