"""Bundles on their way into a library: while one is proven and published, the next one is already coming."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from host_sync.errors import SourceLost
from host_sync.library import Library
from host_sync.library_index import files_by_hash
from host_sync.offload.bundle_transfer import Advance, Offer, fetch, prove
from host_sync.offload.ledger import Ledger
from host_sync.offload.receipting import Vouch
from host_sync.offload.source import Source


class Assembly:
    """A context manager; when it ends, every bundle that came whole is published or noted as failed."""

    def __init__(self, source: Source, library: Library, ledger: Ledger, vouch: Vouch | None) -> None:
        self._source = source
        self._library = library
        self._ledger = ledger
        self._vouch = vouch
        self._known = files_by_hash(library)
        self._background = ThreadPoolExecutor(max_workers=1, thread_name_prefix="prove")
        self._under_way: tuple[Offer, Future[None]] | None = None

    def __enter__(self) -> Assembly:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._background:
            if error is None:
                self._settle(self._vouch)
            elif isinstance(error, SourceLost):
                self._settle(None)  # nobody is there to take a receipt; the next pull re-reads it and leaves one

    def add(self, offer: Offer, advance: Advance) -> None:
        """Fetch a bundle; it is proven and published while the next one is added.

        Raises
        ------
        SourceLost
            The source went away; what came of this bundle is kept.
        LibraryError
            The library cannot be written.
        """
        with self._ledger.noting_failure(offer), ExitStack() as stack:
            partial = stack.enter_context(self._library.publishing(offer.kind, offer.bundle_id))
            fetch(self._source, offer, partial, advance, self._known)
            self._settle(self._vouch)
            self._under_way = offer, self._background.submit(_finish, stack.pop_all(), offer, partial)

    def _settle(self, vouch: Vouch | None) -> None:
        """Wait for the bundle that is being proven, and leave its receipt."""
        if self._under_way is None:
            return
        offer, proven = self._under_way
        self._under_way = None
        with self._ledger.noting_failure(offer):
            proven.result()
            self._ledger.copied.append(offer.bundle_id)
            if vouch:
                vouch.for_bundle(self._source, offer)


def _finish(publishing: ExitStack, offer: Offer, partial: Path) -> None:
    with publishing:
        prove(offer, partial)
