"""What a control loop asks of the kernel: real-time scheduling, and memory that is never paged out.

How this works
--------------
The service manager starts us with SCHED_FIFO and with SCHED_RESET_ON_FORK, so that no child, least of all the
recorder, is ever born with real-time priority. The same flag makes every new thread an ordinary one. That is right for
Zenoh's own threads: a flood from the network must not starve the loop. Python's threads take the interpreter lock that
the loop needs, so they are given the loop's priority once all of them exist.
Pages are locked as they are first touched: locking everything mapped would take 2.5 GB (measured with Rerun's library).
"""

import ctypes
import logging
import os
import threading

logger = logging.getLogger(__name__)

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # linux/mman.h; the same on x86 and ARM
_REAL_TIME = (os.SCHED_FIFO, os.SCHED_RR)


def enter() -> bool:
    """If we were started with real-time scheduling, extend it to Python's threads and lock memory; whether we were."""
    policy = os.sched_getscheduler(0)
    if policy & ~os.SCHED_RESET_ON_FORK not in _REAL_TIME:
        return False
    parameter = os.sched_getparam(0)
    for thread in threading.enumerate():
        if thread.native_id is not None:
            os.sched_setscheduler(thread.native_id, policy, parameter)
    if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        logger.warning("memory cannot be locked (%s): paging may stall the loop", os.strerror(ctypes.get_errno()))
    return True
