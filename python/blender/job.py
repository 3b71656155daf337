# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work on a thread of its own, watched from the main thread. Knows nothing of Blender."""

import threading

import svbrdf_gcn


class Job:
    """Runs `work(progress=..., cancel=...)` on a thread; every method here is called from the thread that made the job.

    Parameters
    ----------
    work : callable
        Takes the keyword arguments `progress` (called with a `svbrdf_gcn.Progress`) and `cancel` (a `svbrdf_gcn.CancelToken`).
    """

    def __init__(self, work):
        self._work = work
        self._cancel = svbrdf_gcn.CancelToken()
        self._latest = None
        self._result = None
        self._error = None
        self._thread = threading.Thread(target=self._run, name="svbrdf_gcn fit", daemon=True)
        self._thread.start()

    def _run(self):
        try:
            self._result = self._work(progress=self._note, cancel=self._cancel)
        except BaseException as error:  # Whatever it is, it is raised again where somebody listens.
            self._error = error

    def _note(self, progress):
        self._latest = progress

    @property
    def running(self):
        """Whether the work goes on."""
        return self._thread.is_alive()

    @property
    def progress(self):
        """The latest report, or None."""
        return self._latest

    def cancel(self):
        """Ask the work to stop; it does so within a fraction of a second."""
        self._cancel.cancel()

    def result(self):
        """Wait for the work and return what it returned, or raise what it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._result
