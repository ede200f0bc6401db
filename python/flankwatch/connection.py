"""The connection to the service: requests, retries, pages and errors."""

from __future__ import annotations

import time as clock
from typing import Any, Iterator, Mapping, TypeVar

import httpx

Self = TypeVar("Self", bound="Connection")

#: Statuses after which the same request may succeed.
RETRIED_STATUSES = {429, 502, 503, 504, 507}


class ServiceError(Exception):
    """Raised when the service refuses a request.

    Attributes:
        status: HTTP status.
        detail: the reason, in words.
        field, value, expected: the field at fault, if there is one.
    """

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        self.status = status
        self.detail = str(problem.get("detail") or problem.get("title") or "no reason given")
        self.field = problem.get("field")
        self.value = problem.get("value")
        self.expected = problem.get("expected")
        super().__init__(f"{status}: {self.detail}")


def without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values that are not ``None``."""
    return {name: value for name, value in values.items() if value is not None}


def wait_s(response: httpx.Response) -> float:
    """Returns the seconds to wait before a repetition, at most 30."""
    try:
        return min(max(float(response.headers["retry-after"]), 0.0), 30.0)
    except (KeyError, ValueError):
        # A proxy may state a date.
        return 1.0


class Connection:
    """An HTTP connection that repeats requests to a busy service."""

    def __init__(
        self,
        url: str = "http://127.0.0.1:8600",
        token: str | None = None,
        *,
        timeout_s: float = 60.0,
        repeats: int = 5,
        verify: bool | str = True,
    ) -> None:
        headers = {"authorization": f"Bearer {token}"} if token else {}
        self.url = url
        self._repeats = repeats
        self._http = httpx.Client(base_url=url, headers=headers, timeout=timeout_s, verify=verify)

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection."""
        self._http.close()

    def request(self, method: str, path: str, **arguments: Any) -> Any:
        """Sends a request and returns the decoded JSON; retries it if the service is busy.

        Raises:
            ServiceError: if the service refuses the request.
            httpx.TransportError: if the service cannot be reached.
        """
        return self._send(method, path, **arguments).json()

    def _send(self, method: str, path: str, **arguments: Any) -> httpx.Response:
        for attempt in range(self._repeats + 1):
            response = self._http.request(method, path, **arguments)
            if response.status_code not in RETRIED_STATUSES or attempt == self._repeats:
                break
            clock.sleep(wait_s(response))
        if response.status_code >= 400:
            try:
                problem = response.json()
            except ValueError:
                problem = {"detail": response.text}
            raise ServiceError(response.status_code, problem)
        return response

    def _pages(self, path: str, parameters: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        cursor = None
        while True:
            page = self.request("GET", path, params=without_none({**parameters, "cursor": cursor}))
            yield from page["items"]
            cursor = page.get("next_cursor")
            if not cursor:
                return
