"""Condition monitoring for spur gears: indicators, gear model, wear estimate, and a client of the service.

Samples are one-dimensional arrays of real numbers, rates are in hertz, and times are RFC 3339 text,
``datetime``, ``numpy.datetime64`` or seconds since 1970. Invalid arguments raise ``ValueError`` with the
argument, its value and what was expected.
"""

from ._flankwatch import (
    AngleRecord,
    Cepstrum,
    Ensemble,
    EnvelopeSpectrum,
    Flank,
    GearSignals,
    Kurtogram,
    Library,
    MeshCycle,
    OrderSpectrum,
    Pair,
    Run,
    SimulatedRecord,
    Simulation,
    Spectrum,
    ToothContact,
    Tracker,
    amplitude_spectrum,
    angle_record,
    cepstrum,
    envelope_spectrum,
    gear_signals,
    kurtogram,
    order_spectrum,
    power_spectral_density,
)
from .client import Client
from .condition import Indicators, indicators, synchronous_average
from .connection import ServiceError
from .events import Event
from .recording import Channel, Recording, RecordingError
from .reading import read

__all__ = [
    "AngleRecord",
    "Cepstrum",
    "Channel",
    "Client",
    "Ensemble",
    "EnvelopeSpectrum",
    "Event",
    "Flank",
    "GearSignals",
    "Indicators",
    "Kurtogram",
    "Library",
    "MeshCycle",
    "OrderSpectrum",
    "Pair",
    "Recording",
    "RecordingError",
    "Run",
    "ServiceError",
    "SimulatedRecord",
    "Simulation",
    "Spectrum",
    "ToothContact",
    "Tracker",
    "amplitude_spectrum",
    "angle_record",
    "cepstrum",
    "envelope_spectrum",
    "gear_signals",
    "indicators",
    "kurtogram",
    "order_spectrum",
    "power_spectral_density",
    "read",
    "synchronous_average",
]
