"""Bundles on their way into a library: while some are proven and published, the next one is coming."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from types import TracebackType
from typing import Final

from host_sync.errors import LibraryError, SourceLost
from host_sync.library import Library
from host_sync.library_index import files_by_hash
from host_sync.offload.bundle_transfer import Advance, Offer, fetch, prove
from host_sync.offload.ledger import Ledger
from host_sync.offload.receipting import Vouch
from host_sync.offload.source import Source

MOST_UNDER_WAY: Final = 2
"""Bundles that are proven at a time: disks wait, and while one does the other is read back."""


class Assembly:
    """A context manager; when it ends, every bundle that came whole is published or noted as failed."""

    def __init__(self, source: Source, library: Library, ledger: Ledger, vouch: Vouch | None) -> None:
        self._source = source
        self._library = library
        self._ledger = ledger
        self._vouch = vouch
        self._known = files_by_hash(library)
        self._background = ThreadPoolExecutor(MOST_UNDER_WAY, thread_name_prefix="prove")
        self._under_way: deque[tuple[Offer, Future[str | None]]] = deque()

    def __enter__(self) -> Assembly:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._background:
            while self._under_way:
                # Whatever ended it, what is under way is finished; its own trouble matters when there is no other.
                with suppress(LibraryError) if error else nullcontext():
                    self._settle()

    def add(self, offer: Offer, advance: Advance) -> None:
        """Fetch a bundle; it is proven, published and receipted while the next ones are added.

        Raises
        ------
        SourceLost
            The source went away; what came of this bundle is kept.
        LibraryError
            The library cannot be written.
        """
        with self._ledger.noting_failure(offer), ExitStack() as stack:
            partial = stack.enter_context(self._library.publishing(offer.kind, offer.bundle_id, offer.files))
            fetch(self._source, offer, partial, advance, self._known)
            while len(self._under_way) >= MOST_UNDER_WAY:
                self._settle()
            self._under_way.append((offer, self._background.submit(self._finish, stack.pop_all(), offer, partial)))

    def _settle(self) -> None:
        """Wait for the bundle that has been proven the longest, and note what became of it."""
        offer, proven = self._under_way.popleft()
        with self._ledger.noting_failure(offer):
            lost = proven.result()
            self._ledger.copied.append(offer.bundle_id)
            self._ledger.lost = self._ledger.lost or lost

    def _finish(self, publishing: ExitStack, offer: Offer, partial: Path) -> str | None:
        """Why no receipt could be left for a bundle that is published now: nobody is there any more to take it.

        The next pull re-reads such a bundle and leaves the receipt.
        """
        with publishing:
            prove(offer, partial)
        try:
            if self._vouch:
                self._vouch.for_bundle(self._source, offer)
        except SourceLost as error:
            return str(error)
        return None
