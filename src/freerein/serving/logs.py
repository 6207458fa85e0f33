"""Structured logs: one JSON object per line on stderr, long values truncated."""

import logging
import sys
import threading
from typing import Any

import structlog

_MAX_CHARACTERS = 2_000


def configure(service: str) -> None:
    """Configures logging of this process: JSON lines on stderr with time, level, service and event."""
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.stdlib.ExtraAdder(),
            _truncate,
            structlog.processors.format_exc_info,
        ],
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            structlog.processors.JSONRenderer(),
        ],
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.captureWarnings(True)
    for name in ("uvicorn", "python_multipart"):  # whose warnings are of what clients send
        logging.getLogger(name).setLevel(logging.ERROR)
    logging.getLogger("httpx").setLevel(logging.WARNING)  # a line for each call that is passed on
    logging.getLogger("grpc._cython.cygrpc").addFilter(_is_not_the_callers)
    sys.excepthook = _log_crash
    threading.excepthook = lambda crash: _log_crash(crash.exc_type, crash.exc_value, crash.exc_traceback)
    structlog.contextvars.bind_contextvars(service=service)


def set_level(level: str) -> None:
    """Sets the least level that is logged: `debug`, `info`, `warning` or `error`.

    Other libraries stay at `info`: at `debug` they write down what clients send.
    """
    number = logging.getLevelNamesMapping()[level.upper()]
    logging.getLogger().setLevel(max(number, logging.INFO))
    logging.getLogger("freerein").setLevel(number)


def _is_not_the_callers(record: logging.LogRecord) -> bool:
    """Drops gRPC's tracebacks for metadata in no encoding, which may hold a token, and for callers that are gone."""
    return not record.getMessage().startswith(("Invalid encoding", "ExecuteBatchError raised in core"))


def _log_crash(_kind: object, error: BaseException | None, _trace: object) -> None:
    logging.getLogger(__name__).critical("crashed", exc_info=error)


def _truncate(_logger: Any, _method: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    return {key: value[:_MAX_CHARACTERS] if isinstance(value, str) else value for key, value in event.items()}
