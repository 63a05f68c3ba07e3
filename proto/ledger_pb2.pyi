from plotfeed.proto import plotfeed_pb2 as _plotfeed_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class LedgerBatch(_message.Message):
    __slots__ = ("sensors", "targets", "topics", "links", "destinations", "sectors", "looks", "plots", "messages", "claims")
    SENSORS_FIELD_NUMBER: _ClassVar[int]
    TARGETS_FIELD_NUMBER: _ClassVar[int]
    TOPICS_FIELD_NUMBER: _ClassVar[int]
    LINKS_FIELD_NUMBER: _ClassVar[int]
    DESTINATIONS_FIELD_NUMBER: _ClassVar[int]
    SECTORS_FIELD_NUMBER: _ClassVar[int]
    LOOKS_FIELD_NUMBER: _ClassVar[int]
    PLOTS_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_FIELD_NUMBER: _ClassVar[int]
    CLAIMS_FIELD_NUMBER: _ClassVar[int]
    sensors: _containers.RepeatedScalarFieldContainer[str]
    targets: _containers.RepeatedScalarFieldContainer[str]
    topics: _containers.RepeatedScalarFieldContainer[str]
    links: _containers.RepeatedScalarFieldContainer[str]
    destinations: _containers.RepeatedScalarFieldContainer[str]
    sectors: SectorColumns
    looks: LookColumns
    plots: PlotColumns
    messages: MessageColumns
    claims: _containers.RepeatedCompositeFieldContainer[_plotfeed_pb2.Claim]
    def __init__(self, sensors: _Optional[_Iterable[str]] = ..., targets: _Optional[_Iterable[str]] = ..., topics: _Optional[_Iterable[str]] = ..., links: _Optional[_Iterable[str]] = ..., destinations: _Optional[_Iterable[str]] = ..., sectors: _Optional[_Union[SectorColumns, _Mapping]] = ..., looks: _Optional[_Union[LookColumns, _Mapping]] = ..., plots: _Optional[_Union[PlotColumns, _Mapping]] = ..., messages: _Optional[_Union[MessageColumns, _Mapping]] = ..., claims: _Optional[_Iterable[_Union[_plotfeed_pb2.Claim, _Mapping]]] = ...) -> None: ...

class SectorColumns(_message.Message):
    __slots__ = ("sensor", "scan", "sector", "end_utc_ns", "link", "looks_end", "plots_end", "messages_end", "claims_end")
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    SCAN_FIELD_NUMBER: _ClassVar[int]
    SECTOR_FIELD_NUMBER: _ClassVar[int]
    END_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    LOOKS_END_FIELD_NUMBER: _ClassVar[int]
    PLOTS_END_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_END_FIELD_NUMBER: _ClassVar[int]
    CLAIMS_END_FIELD_NUMBER: _ClassVar[int]
    sensor: _containers.RepeatedScalarFieldContainer[int]
    scan: _containers.RepeatedScalarFieldContainer[int]
    sector: _containers.RepeatedScalarFieldContainer[int]
    end_utc_ns: _containers.RepeatedScalarFieldContainer[int]
    link: _containers.RepeatedScalarFieldContainer[int]
    looks_end: _containers.RepeatedScalarFieldContainer[int]
    plots_end: _containers.RepeatedScalarFieldContainer[int]
    messages_end: _containers.RepeatedScalarFieldContainer[int]
    claims_end: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, sensor: _Optional[_Iterable[int]] = ..., scan: _Optional[_Iterable[int]] = ..., sector: _Optional[_Iterable[int]] = ..., end_utc_ns: _Optional[_Iterable[int]] = ..., link: _Optional[_Iterable[int]] = ..., looks_end: _Optional[_Iterable[int]] = ..., plots_end: _Optional[_Iterable[int]] = ..., messages_end: _Optional[_Iterable[int]] = ..., claims_end: _Optional[_Iterable[int]] = ...) -> None: ...

class LookColumns(_message.Message):
    __slots__ = ("target", "time_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "snr_db", "pd", "detected", "channel", "emitted_utc_ns")
    TARGET_FIELD_NUMBER: _ClassVar[int]
    TIME_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    SNR_DB_FIELD_NUMBER: _ClassVar[int]
    PD_FIELD_NUMBER: _ClassVar[int]
    DETECTED_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    EMITTED_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    target: _containers.RepeatedScalarFieldContainer[int]
    time_utc_ns: _containers.RepeatedScalarFieldContainer[int]
    range_m: _containers.RepeatedScalarFieldContainer[float]
    azimuth_deg: _containers.RepeatedScalarFieldContainer[float]
    elevation_deg: _containers.RepeatedScalarFieldContainer[float]
    snr_db: _containers.RepeatedScalarFieldContainer[float]
    pd: _containers.RepeatedScalarFieldContainer[float]
    detected: _containers.RepeatedScalarFieldContainer[bool]
    channel: _containers.RepeatedScalarFieldContainer[int]
    emitted_utc_ns: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, target: _Optional[_Iterable[int]] = ..., time_utc_ns: _Optional[_Iterable[int]] = ..., range_m: _Optional[_Iterable[float]] = ..., azimuth_deg: _Optional[_Iterable[float]] = ..., elevation_deg: _Optional[_Iterable[float]] = ..., snr_db: _Optional[_Iterable[float]] = ..., pd: _Optional[_Iterable[float]] = ..., detected: _Optional[_Iterable[bool]] = ..., channel: _Optional[_Iterable[int]] = ..., emitted_utc_ns: _Optional[_Iterable[int]] = ...) -> None: ...

class PlotColumns(_message.Message):
    __slots__ = ("target", "time_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "range_rate_m_s", "merged_plot", "merged_target")
    TARGET_FIELD_NUMBER: _ClassVar[int]
    TIME_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    RANGE_RATE_M_S_FIELD_NUMBER: _ClassVar[int]
    MERGED_PLOT_FIELD_NUMBER: _ClassVar[int]
    MERGED_TARGET_FIELD_NUMBER: _ClassVar[int]
    target: _containers.RepeatedScalarFieldContainer[int]
    time_utc_ns: _containers.RepeatedScalarFieldContainer[int]
    range_m: _containers.RepeatedScalarFieldContainer[float]
    azimuth_deg: _containers.RepeatedScalarFieldContainer[float]
    elevation_deg: _containers.RepeatedScalarFieldContainer[float]
    range_rate_m_s: _containers.RepeatedScalarFieldContainer[float]
    merged_plot: _containers.RepeatedScalarFieldContainer[int]
    merged_target: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, target: _Optional[_Iterable[int]] = ..., time_utc_ns: _Optional[_Iterable[int]] = ..., range_m: _Optional[_Iterable[float]] = ..., azimuth_deg: _Optional[_Iterable[float]] = ..., elevation_deg: _Optional[_Iterable[float]] = ..., range_rate_m_s: _Optional[_Iterable[float]] = ..., merged_plot: _Optional[_Iterable[int]] = ..., merged_target: _Optional[_Iterable[int]] = ...) -> None: ...

class MessageColumns(_message.Message):
    __slots__ = ("topic", "due_utc_ns", "sent_utc_ns", "octets", "fate", "link_due_utc_ns", "number", "copy", "flipped_bit", "missed_message", "missed_destination")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    DUE_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    OCTETS_FIELD_NUMBER: _ClassVar[int]
    FATE_FIELD_NUMBER: _ClassVar[int]
    LINK_DUE_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    COPY_FIELD_NUMBER: _ClassVar[int]
    FLIPPED_BIT_FIELD_NUMBER: _ClassVar[int]
    MISSED_MESSAGE_FIELD_NUMBER: _ClassVar[int]
    MISSED_DESTINATION_FIELD_NUMBER: _ClassVar[int]
    topic: _containers.RepeatedScalarFieldContainer[int]
    due_utc_ns: _containers.RepeatedScalarFieldContainer[int]
    sent_utc_ns: _containers.RepeatedScalarFieldContainer[int]
    octets: _containers.RepeatedScalarFieldContainer[int]
    fate: _containers.RepeatedScalarFieldContainer[_plotfeed_pb2.Fate]
    link_due_utc_ns: _containers.RepeatedScalarFieldContainer[int]
    number: _containers.RepeatedScalarFieldContainer[int]
    copy: _containers.RepeatedScalarFieldContainer[int]
    flipped_bit: _containers.RepeatedScalarFieldContainer[int]
    missed_message: _containers.RepeatedScalarFieldContainer[int]
    missed_destination: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, topic: _Optional[_Iterable[int]] = ..., due_utc_ns: _Optional[_Iterable[int]] = ..., sent_utc_ns: _Optional[_Iterable[int]] = ..., octets: _Optional[_Iterable[int]] = ..., fate: _Optional[_Iterable[_Union[_plotfeed_pb2.Fate, str]]] = ..., link_due_utc_ns: _Optional[_Iterable[int]] = ..., number: _Optional[_Iterable[int]] = ..., copy: _Optional[_Iterable[int]] = ..., flipped_bit: _Optional[_Iterable[int]] = ..., missed_message: _Optional[_Iterable[int]] = ..., missed_destination: _Optional[_Iterable[int]] = ...) -> None: ...
