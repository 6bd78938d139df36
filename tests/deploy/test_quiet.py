"""Exporters and quantizers print nothing, and the terminal speaks again afterwards."""

import logging
import sys
import threading

from eldenet.deploy.onnx_export import quiet


def test_threads_that_leave_in_another_order_than_they_entered_leave_the_terminal_as_it_was() -> None:
    before = sys.stdout, logging.root.manager.disable
    first_is_in, both_tried = threading.Event(), threading.Event()

    def first() -> None:
        with quiet():
            first_is_in.set()
            both_tried.wait(0.2)  # the second must wait, so nobody sets it

    def second() -> None:
        first_is_in.wait(60)
        with quiet():
            both_tried.set()
            threads[0].join(60)

    threads = [threading.Thread(target=first), threading.Thread(target=second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert (sys.stdout, logging.root.manager.disable) == before
