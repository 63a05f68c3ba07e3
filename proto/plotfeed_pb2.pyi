import datetime

from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class AltitudeReference(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ALTITUDE_REFERENCE_UNSPECIFIED: _ClassVar[AltitudeReference]
    ELLIPSOID: _ClassVar[AltitudeReference]
    MEAN_SEA_LEVEL: _ClassVar[AltitudeReference]
    ABOVE_TAKEOFF: _ClassVar[AltitudeReference]

class TrackKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TRACK_KIND_UNSPECIFIED: _ClassVar[TrackKind]
    SMOOTHED_TRUTH: _ClassVar[TrackKind]
    PLAIN: _ClassVar[TrackKind]

class Fate(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FATE_UNSPECIFIED: _ClassVar[Fate]
    SENT: _ClassVar[Fate]
    LOST: _ClassVar[Fate]
    QUEUE_FULL: _ClassVar[Fate]
    OUTAGE: _ClassVar[Fate]
    UNDELIVERED: _ClassVar[Fate]
    ENDED: _ClassVar[Fate]
    STALE: _ClassVar[Fate]
ALTITUDE_REFERENCE_UNSPECIFIED: AltitudeReference
ELLIPSOID: AltitudeReference
MEAN_SEA_LEVEL: AltitudeReference
ABOVE_TAKEOFF: AltitudeReference
TRACK_KIND_UNSPECIFIED: TrackKind
SMOOTHED_TRUTH: TrackKind
PLAIN: TrackKind
FATE_UNSPECIFIED: Fate
SENT: Fate
LOST: Fate
QUEUE_FULL: Fate
OUTAGE: Fate
UNDELIVERED: Fate
ENDED: Fate
STALE: Fate

class Telemetry(_message.Message):
    __slots__ = ("time_utc", "latitude_deg", "longitude_deg", "altitude_m", "altitude_reference", "velocity_east_m_s", "velocity_north_m_s", "velocity_up_m_s", "horizontal_accuracy_m", "vertical_accuracy_m", "velocity_accuracy_m_s", "rcs_m2", "sound_power_db", "emitters", "target_class", "size_m")
    TIME_UTC_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_M_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_REFERENCE_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_EAST_M_S_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_NORTH_M_S_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_UP_M_S_FIELD_NUMBER: _ClassVar[int]
    HORIZONTAL_ACCURACY_M_FIELD_NUMBER: _ClassVar[int]
    VERTICAL_ACCURACY_M_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_ACCURACY_M_S_FIELD_NUMBER: _ClassVar[int]
    RCS_M2_FIELD_NUMBER: _ClassVar[int]
    SOUND_POWER_DB_FIELD_NUMBER: _ClassVar[int]
    EMITTERS_FIELD_NUMBER: _ClassVar[int]
    TARGET_CLASS_FIELD_NUMBER: _ClassVar[int]
    SIZE_M_FIELD_NUMBER: _ClassVar[int]
    time_utc: _timestamp_pb2.Timestamp
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    altitude_reference: AltitudeReference
    velocity_east_m_s: float
    velocity_north_m_s: float
    velocity_up_m_s: float
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    velocity_accuracy_m_s: float
    rcs_m2: float
    sound_power_db: float
    emitters: _containers.RepeatedCompositeFieldContainer[Emitter]
    target_class: str
    size_m: float
    def __init__(self, time_utc: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., altitude_m: _Optional[float] = ..., altitude_reference: _Optional[_Union[AltitudeReference, str]] = ..., velocity_east_m_s: _Optional[float] = ..., velocity_north_m_s: _Optional[float] = ..., velocity_up_m_s: _Optional[float] = ..., horizontal_accuracy_m: _Optional[float] = ..., vertical_accuracy_m: _Optional[float] = ..., velocity_accuracy_m_s: _Optional[float] = ..., rcs_m2: _Optional[float] = ..., sound_power_db: _Optional[float] = ..., emitters: _Optional[_Iterable[_Union[Emitter, _Mapping]]] = ..., target_class: _Optional[str] = ..., size_m: _Optional[float] = ...) -> None: ...

class Emitter(_message.Message):
    __slots__ = ("frequency_hz", "bandwidth_hz", "eirp_dbm", "kind", "identity")
    FREQUENCY_HZ_FIELD_NUMBER: _ClassVar[int]
    BANDWIDTH_HZ_FIELD_NUMBER: _ClassVar[int]
    EIRP_DBM_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    IDENTITY_FIELD_NUMBER: _ClassVar[int]
    frequency_hz: float
    bandwidth_hz: float
    eirp_dbm: float
    kind: str
    identity: str
    def __init__(self, frequency_hz: _Optional[float] = ..., bandwidth_hz: _Optional[float] = ..., eirp_dbm: _Optional[float] = ..., kind: _Optional[str] = ..., identity: _Optional[str] = ...) -> None: ...

class PlotBatch(_message.Message):
    __slots__ = ("sensor", "scan", "sector", "plots")
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    SCAN_FIELD_NUMBER: _ClassVar[int]
    SECTOR_FIELD_NUMBER: _ClassVar[int]
    PLOTS_FIELD_NUMBER: _ClassVar[int]
    sensor: str
    scan: int
    sector: int
    plots: _containers.RepeatedCompositeFieldContainer[Plot]
    def __init__(self, sensor: _Optional[str] = ..., scan: _Optional[int] = ..., sector: _Optional[int] = ..., plots: _Optional[_Iterable[_Union[Plot, _Mapping]]] = ...) -> None: ...

class Plot(_message.Message):
    __slots__ = ("time_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "height_m", "snr_db", "amplitude_dbm", "sigma_range_m", "sigma_azimuth_deg", "sigma_elevation_deg", "channel", "bistatic_range_m", "sigma_bistatic_range_m", "covariance_east_m2", "covariance_north_m2", "covariance_east_north_m2", "kind", "identity", "range_rate_m_s", "sigma_range_rate_m_s", "kind_probability")
    TIME_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    SNR_DB_FIELD_NUMBER: _ClassVar[int]
    AMPLITUDE_DBM_FIELD_NUMBER: _ClassVar[int]
    SIGMA_RANGE_M_FIELD_NUMBER: _ClassVar[int]
    SIGMA_AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    SIGMA_ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    BISTATIC_RANGE_M_FIELD_NUMBER: _ClassVar[int]
    SIGMA_BISTATIC_RANGE_M_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_EAST_M2_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_NORTH_M2_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_EAST_NORTH_M2_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    IDENTITY_FIELD_NUMBER: _ClassVar[int]
    RANGE_RATE_M_S_FIELD_NUMBER: _ClassVar[int]
    SIGMA_RANGE_RATE_M_S_FIELD_NUMBER: _ClassVar[int]
    KIND_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    time_utc_ns: int
    range_m: float
    azimuth_deg: float
    elevation_deg: float
    height_m: float
    snr_db: float
    amplitude_dbm: float
    sigma_range_m: float
    sigma_azimuth_deg: float
    sigma_elevation_deg: float
    channel: int
    bistatic_range_m: float
    sigma_bistatic_range_m: float
    covariance_east_m2: float
    covariance_north_m2: float
    covariance_east_north_m2: float
    kind: str
    identity: str
    range_rate_m_s: float
    sigma_range_rate_m_s: float
    kind_probability: float
    def __init__(self, time_utc_ns: _Optional[int] = ..., range_m: _Optional[float] = ..., azimuth_deg: _Optional[float] = ..., elevation_deg: _Optional[float] = ..., height_m: _Optional[float] = ..., snr_db: _Optional[float] = ..., amplitude_dbm: _Optional[float] = ..., sigma_range_m: _Optional[float] = ..., sigma_azimuth_deg: _Optional[float] = ..., sigma_elevation_deg: _Optional[float] = ..., channel: _Optional[int] = ..., bistatic_range_m: _Optional[float] = ..., sigma_bistatic_range_m: _Optional[float] = ..., covariance_east_m2: _Optional[float] = ..., covariance_north_m2: _Optional[float] = ..., covariance_east_north_m2: _Optional[float] = ..., kind: _Optional[str] = ..., identity: _Optional[str] = ..., range_rate_m_s: _Optional[float] = ..., sigma_range_rate_m_s: _Optional[float] = ..., kind_probability: _Optional[float] = ...) -> None: ...

class TrackBatch(_message.Message):
    __slots__ = ("sensor", "scan", "sector", "kind", "tracks")
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    SCAN_FIELD_NUMBER: _ClassVar[int]
    SECTOR_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    TRACKS_FIELD_NUMBER: _ClassVar[int]
    sensor: str
    scan: int
    sector: int
    kind: TrackKind
    tracks: _containers.RepeatedCompositeFieldContainer[Track]
    def __init__(self, sensor: _Optional[str] = ..., scan: _Optional[int] = ..., sector: _Optional[int] = ..., kind: _Optional[_Union[TrackKind, str]] = ..., tracks: _Optional[_Iterable[_Union[Track, _Mapping]]] = ...) -> None: ...

class Track(_message.Message):
    __slots__ = ("id", "number", "time_utc_ns", "latitude_deg", "longitude_deg", "height_m", "velocity_east_m_s", "velocity_north_m_s", "climb_m_s", "age_s", "coasted", "first", "last", "sigma_east_m", "sigma_north_m", "sigma_up_m", "sigma_velocity_east_m_s", "sigma_velocity_north_m_s", "sigma_climb_m_s")
    ID_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    TIME_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_EAST_M_S_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_NORTH_M_S_FIELD_NUMBER: _ClassVar[int]
    CLIMB_M_S_FIELD_NUMBER: _ClassVar[int]
    AGE_S_FIELD_NUMBER: _ClassVar[int]
    COASTED_FIELD_NUMBER: _ClassVar[int]
    FIRST_FIELD_NUMBER: _ClassVar[int]
    LAST_FIELD_NUMBER: _ClassVar[int]
    SIGMA_EAST_M_FIELD_NUMBER: _ClassVar[int]
    SIGMA_NORTH_M_FIELD_NUMBER: _ClassVar[int]
    SIGMA_UP_M_FIELD_NUMBER: _ClassVar[int]
    SIGMA_VELOCITY_EAST_M_S_FIELD_NUMBER: _ClassVar[int]
    SIGMA_VELOCITY_NORTH_M_S_FIELD_NUMBER: _ClassVar[int]
    SIGMA_CLIMB_M_S_FIELD_NUMBER: _ClassVar[int]
    id: str
    number: int
    time_utc_ns: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    velocity_east_m_s: float
    velocity_north_m_s: float
    climb_m_s: float
    age_s: float
    coasted: bool
    first: bool
    last: bool
    sigma_east_m: float
    sigma_north_m: float
    sigma_up_m: float
    sigma_velocity_east_m_s: float
    sigma_velocity_north_m_s: float
    sigma_climb_m_s: float
    def __init__(self, id: _Optional[str] = ..., number: _Optional[int] = ..., time_utc_ns: _Optional[int] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_m: _Optional[float] = ..., velocity_east_m_s: _Optional[float] = ..., velocity_north_m_s: _Optional[float] = ..., climb_m_s: _Optional[float] = ..., age_s: _Optional[float] = ..., coasted: _Optional[bool] = ..., first: _Optional[bool] = ..., last: _Optional[bool] = ..., sigma_east_m: _Optional[float] = ..., sigma_north_m: _Optional[float] = ..., sigma_up_m: _Optional[float] = ..., sigma_velocity_east_m_s: _Optional[float] = ..., sigma_velocity_north_m_s: _Optional[float] = ..., sigma_climb_m_s: _Optional[float] = ...) -> None: ...

class Ledger(_message.Message):
    __slots__ = ("sensor", "scan", "sector", "looks", "plots", "messages", "link", "claims")
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    SCAN_FIELD_NUMBER: _ClassVar[int]
    SECTOR_FIELD_NUMBER: _ClassVar[int]
    LOOKS_FIELD_NUMBER: _ClassVar[int]
    PLOTS_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    CLAIMS_FIELD_NUMBER: _ClassVar[int]
    sensor: str
    scan: int
    sector: int
    looks: _containers.RepeatedCompositeFieldContainer[Look]
    plots: _containers.RepeatedCompositeFieldContainer[PlotTruth]
    messages: _containers.RepeatedCompositeFieldContainer[Sent]
    link: str
    claims: _containers.RepeatedCompositeFieldContainer[Claim]
    def __init__(self, sensor: _Optional[str] = ..., scan: _Optional[int] = ..., sector: _Optional[int] = ..., looks: _Optional[_Iterable[_Union[Look, _Mapping]]] = ..., plots: _Optional[_Iterable[_Union[PlotTruth, _Mapping]]] = ..., messages: _Optional[_Iterable[_Union[Sent, _Mapping]]] = ..., link: _Optional[str] = ..., claims: _Optional[_Iterable[_Union[Claim, _Mapping]]] = ...) -> None: ...

class Claim(_message.Message):
    __slots__ = ("drone", "time_utc_ns", "latitude_deg", "longitude_deg", "height_m", "error_east_m", "error_north_m", "error_up_m", "faults", "contingency")
    DRONE_FIELD_NUMBER: _ClassVar[int]
    TIME_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    ERROR_EAST_M_FIELD_NUMBER: _ClassVar[int]
    ERROR_NORTH_M_FIELD_NUMBER: _ClassVar[int]
    ERROR_UP_M_FIELD_NUMBER: _ClassVar[int]
    FAULTS_FIELD_NUMBER: _ClassVar[int]
    CONTINGENCY_FIELD_NUMBER: _ClassVar[int]
    drone: str
    time_utc_ns: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    error_east_m: float
    error_north_m: float
    error_up_m: float
    faults: _containers.RepeatedScalarFieldContainer[str]
    contingency: str
    def __init__(self, drone: _Optional[str] = ..., time_utc_ns: _Optional[int] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_m: _Optional[float] = ..., error_east_m: _Optional[float] = ..., error_north_m: _Optional[float] = ..., error_up_m: _Optional[float] = ..., faults: _Optional[_Iterable[str]] = ..., contingency: _Optional[str] = ...) -> None: ...

class Look(_message.Message):
    __slots__ = ("drone", "time_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "snr_db", "pd", "detected", "channel", "emitted_utc_ns", "other")
    DRONE_FIELD_NUMBER: _ClassVar[int]
    TIME_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    SNR_DB_FIELD_NUMBER: _ClassVar[int]
    PD_FIELD_NUMBER: _ClassVar[int]
    DETECTED_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    EMITTED_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    OTHER_FIELD_NUMBER: _ClassVar[int]
    drone: str
    time_utc_ns: int
    range_m: float
    azimuth_deg: float
    elevation_deg: float
    snr_db: float
    pd: float
    detected: bool
    channel: int
    emitted_utc_ns: int
    other: str
    def __init__(self, drone: _Optional[str] = ..., time_utc_ns: _Optional[int] = ..., range_m: _Optional[float] = ..., azimuth_deg: _Optional[float] = ..., elevation_deg: _Optional[float] = ..., snr_db: _Optional[float] = ..., pd: _Optional[float] = ..., detected: _Optional[bool] = ..., channel: _Optional[int] = ..., emitted_utc_ns: _Optional[int] = ..., other: _Optional[str] = ...) -> None: ...

class PlotTruth(_message.Message):
    __slots__ = ("drone", "time_utc_ns", "range_m", "azimuth_deg", "elevation_deg", "range_rate_m_s", "merged_drones", "other")
    DRONE_FIELD_NUMBER: _ClassVar[int]
    TIME_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    RANGE_RATE_M_S_FIELD_NUMBER: _ClassVar[int]
    MERGED_DRONES_FIELD_NUMBER: _ClassVar[int]
    OTHER_FIELD_NUMBER: _ClassVar[int]
    drone: str
    time_utc_ns: int
    range_m: float
    azimuth_deg: float
    elevation_deg: float
    range_rate_m_s: float
    merged_drones: _containers.RepeatedScalarFieldContainer[str]
    other: str
    def __init__(self, drone: _Optional[str] = ..., time_utc_ns: _Optional[int] = ..., range_m: _Optional[float] = ..., azimuth_deg: _Optional[float] = ..., elevation_deg: _Optional[float] = ..., range_rate_m_s: _Optional[float] = ..., merged_drones: _Optional[_Iterable[str]] = ..., other: _Optional[str] = ...) -> None: ...

class Sent(_message.Message):
    __slots__ = ("topic", "due_utc_ns", "sent_utc_ns", "octets", "delivered", "fate", "link_due_utc_ns", "number", "copy", "flipped_bit", "not_to")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    DUE_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    SENT_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    OCTETS_FIELD_NUMBER: _ClassVar[int]
    DELIVERED_FIELD_NUMBER: _ClassVar[int]
    FATE_FIELD_NUMBER: _ClassVar[int]
    LINK_DUE_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    COPY_FIELD_NUMBER: _ClassVar[int]
    FLIPPED_BIT_FIELD_NUMBER: _ClassVar[int]
    NOT_TO_FIELD_NUMBER: _ClassVar[int]
    topic: str
    due_utc_ns: int
    sent_utc_ns: int
    octets: int
    delivered: bool
    fate: Fate
    link_due_utc_ns: int
    number: int
    copy: int
    flipped_bit: int
    not_to: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, topic: _Optional[str] = ..., due_utc_ns: _Optional[int] = ..., sent_utc_ns: _Optional[int] = ..., octets: _Optional[int] = ..., delivered: _Optional[bool] = ..., fate: _Optional[_Union[Fate, str]] = ..., link_due_utc_ns: _Optional[int] = ..., number: _Optional[int] = ..., copy: _Optional[int] = ..., flipped_bit: _Optional[int] = ..., not_to: _Optional[_Iterable[str]] = ...) -> None: ...

class Refusal(_message.Message):
    __slots__ = ("time_utc", "topic", "drone", "reason", "detail", "count")
    TIME_UTC_FIELD_NUMBER: _ClassVar[int]
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    DRONE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    time_utc: _timestamp_pb2.Timestamp
    topic: str
    drone: str
    reason: str
    detail: str
    count: int
    def __init__(self, time_utc: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., topic: _Optional[str] = ..., drone: _Optional[str] = ..., reason: _Optional[str] = ..., detail: _Optional[str] = ..., count: _Optional[int] = ...) -> None: ...

class SensorStatus(_message.Message):
    __slots__ = ("sensor", "state", "time_utc", "scan", "plots", "missed_scans", "refused", "undelivered", "lateness_p50_us", "lateness_p99_us", "lost", "duplicated", "on_the_way", "waiting", "enabled", "conflated", "flooded", "late", "intake_behind_s", "sapient", "latitude_deg", "longitude_deg", "height_m", "undelivered_to", "drones", "forgotten", "refused_by_reason", "mount")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATE_UNSPECIFIED: _ClassVar[SensorStatus.State]
        ONLINE: _ClassVar[SensorStatus.State]
        OFFLINE: _ClassVar[SensorStatus.State]
    STATE_UNSPECIFIED: SensorStatus.State
    ONLINE: SensorStatus.State
    OFFLINE: SensorStatus.State
    class UndeliveredToEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    class RefusedByReasonEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    TIME_UTC_FIELD_NUMBER: _ClassVar[int]
    SCAN_FIELD_NUMBER: _ClassVar[int]
    PLOTS_FIELD_NUMBER: _ClassVar[int]
    MISSED_SCANS_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    UNDELIVERED_FIELD_NUMBER: _ClassVar[int]
    LATENESS_P50_US_FIELD_NUMBER: _ClassVar[int]
    LATENESS_P99_US_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    DUPLICATED_FIELD_NUMBER: _ClassVar[int]
    ON_THE_WAY_FIELD_NUMBER: _ClassVar[int]
    WAITING_FIELD_NUMBER: _ClassVar[int]
    ENABLED_FIELD_NUMBER: _ClassVar[int]
    CONFLATED_FIELD_NUMBER: _ClassVar[int]
    FLOODED_FIELD_NUMBER: _ClassVar[int]
    LATE_FIELD_NUMBER: _ClassVar[int]
    INTAKE_BEHIND_S_FIELD_NUMBER: _ClassVar[int]
    SAPIENT_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    UNDELIVERED_TO_FIELD_NUMBER: _ClassVar[int]
    DRONES_FIELD_NUMBER: _ClassVar[int]
    FORGOTTEN_FIELD_NUMBER: _ClassVar[int]
    REFUSED_BY_REASON_FIELD_NUMBER: _ClassVar[int]
    MOUNT_FIELD_NUMBER: _ClassVar[int]
    sensor: str
    state: SensorStatus.State
    time_utc: _timestamp_pb2.Timestamp
    scan: int
    plots: int
    missed_scans: int
    refused: int
    undelivered: int
    lateness_p50_us: float
    lateness_p99_us: float
    lost: int
    duplicated: int
    on_the_way: int
    waiting: int
    enabled: bool
    conflated: int
    flooded: int
    late: int
    intake_behind_s: float
    sapient: SapientStatus
    latitude_deg: float
    longitude_deg: float
    height_m: float
    undelivered_to: _containers.ScalarMap[str, int]
    drones: int
    forgotten: int
    refused_by_reason: _containers.ScalarMap[str, int]
    mount: MountStatus
    def __init__(self, sensor: _Optional[str] = ..., state: _Optional[_Union[SensorStatus.State, str]] = ..., time_utc: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., scan: _Optional[int] = ..., plots: _Optional[int] = ..., missed_scans: _Optional[int] = ..., refused: _Optional[int] = ..., undelivered: _Optional[int] = ..., lateness_p50_us: _Optional[float] = ..., lateness_p99_us: _Optional[float] = ..., lost: _Optional[int] = ..., duplicated: _Optional[int] = ..., on_the_way: _Optional[int] = ..., waiting: _Optional[int] = ..., enabled: _Optional[bool] = ..., conflated: _Optional[int] = ..., flooded: _Optional[int] = ..., late: _Optional[int] = ..., intake_behind_s: _Optional[float] = ..., sapient: _Optional[_Union[SapientStatus, _Mapping]] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_m: _Optional[float] = ..., undelivered_to: _Optional[_Mapping[str, int]] = ..., drones: _Optional[int] = ..., forgotten: _Optional[int] = ..., refused_by_reason: _Optional[_Mapping[str, int]] = ..., mount: _Optional[_Union[MountStatus, _Mapping]] = ...) -> None: ...

class MountStatus(_message.Message):
    __slots__ = ("time_utc", "pan_deg", "tilt_deg", "horizontal_fov_deg", "settled", "cued_by")
    TIME_UTC_FIELD_NUMBER: _ClassVar[int]
    PAN_DEG_FIELD_NUMBER: _ClassVar[int]
    TILT_DEG_FIELD_NUMBER: _ClassVar[int]
    HORIZONTAL_FOV_DEG_FIELD_NUMBER: _ClassVar[int]
    SETTLED_FIELD_NUMBER: _ClassVar[int]
    CUED_BY_FIELD_NUMBER: _ClassVar[int]
    time_utc: _timestamp_pb2.Timestamp
    pan_deg: float
    tilt_deg: float
    horizontal_fov_deg: float
    settled: bool
    cued_by: str
    def __init__(self, time_utc: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., pan_deg: _Optional[float] = ..., tilt_deg: _Optional[float] = ..., horizontal_fov_deg: _Optional[float] = ..., settled: _Optional[bool] = ..., cued_by: _Optional[str] = ...) -> None: ...

class SapientStatus(_message.Message):
    __slots__ = ("reporting", "connections", "stalls", "refusals", "errors", "tasks", "rejected")
    REPORTING_FIELD_NUMBER: _ClassVar[int]
    CONNECTIONS_FIELD_NUMBER: _ClassVar[int]
    STALLS_FIELD_NUMBER: _ClassVar[int]
    REFUSALS_FIELD_NUMBER: _ClassVar[int]
    ERRORS_FIELD_NUMBER: _ClassVar[int]
    TASKS_FIELD_NUMBER: _ClassVar[int]
    REJECTED_FIELD_NUMBER: _ClassVar[int]
    reporting: bool
    connections: int
    stalls: int
    refusals: int
    errors: int
    tasks: int
    rejected: int
    def __init__(self, reporting: _Optional[bool] = ..., connections: _Optional[int] = ..., stalls: _Optional[int] = ..., refusals: _Optional[int] = ..., errors: _Optional[int] = ..., tasks: _Optional[int] = ..., rejected: _Optional[int] = ...) -> None: ...

class SensorDescription(_message.Message):
    __slots__ = ("sensor", "time_utc", "type", "enabled", "sac", "sic", "latitude_deg", "longitude_deg", "height_m", "altitude_m", "azimuth_reference", "elevation_reference", "range_kind", "scan_kind", "scan_period_s", "sectors", "range_min_m", "range_max_m", "azimuth_min_deg", "azimuth_max_deg", "elevation_min_deg", "elevation_max_deg", "accuracies", "outputs", "transmitters")
    class AzimuthReference(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        AZIMUTH_REFERENCE_UNSPECIFIED: _ClassVar[SensorDescription.AzimuthReference]
        TRUE_NORTH: _ClassVar[SensorDescription.AzimuthReference]
    AZIMUTH_REFERENCE_UNSPECIFIED: SensorDescription.AzimuthReference
    TRUE_NORTH: SensorDescription.AzimuthReference
    class ElevationReference(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        ELEVATION_REFERENCE_UNSPECIFIED: _ClassVar[SensorDescription.ElevationReference]
        HORIZONTAL_OF_SENSOR: _ClassVar[SensorDescription.ElevationReference]
    ELEVATION_REFERENCE_UNSPECIFIED: SensorDescription.ElevationReference
    HORIZONTAL_OF_SENSOR: SensorDescription.ElevationReference
    class RangeKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        RANGE_KIND_UNSPECIFIED: _ClassVar[SensorDescription.RangeKind]
        SLANT: _ClassVar[SensorDescription.RangeKind]
        BISTATIC: _ClassVar[SensorDescription.RangeKind]
        NO_RANGE: _ClassVar[SensorDescription.RangeKind]
    RANGE_KIND_UNSPECIFIED: SensorDescription.RangeKind
    SLANT: SensorDescription.RangeKind
    BISTATIC: SensorDescription.RangeKind
    NO_RANGE: SensorDescription.RangeKind
    SENSOR_FIELD_NUMBER: _ClassVar[int]
    TIME_UTC_FIELD_NUMBER: _ClassVar[int]
    TYPE_FIELD_NUMBER: _ClassVar[int]
    ENABLED_FIELD_NUMBER: _ClassVar[int]
    SAC_FIELD_NUMBER: _ClassVar[int]
    SIC_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_M_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_REFERENCE_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_REFERENCE_FIELD_NUMBER: _ClassVar[int]
    RANGE_KIND_FIELD_NUMBER: _ClassVar[int]
    SCAN_KIND_FIELD_NUMBER: _ClassVar[int]
    SCAN_PERIOD_S_FIELD_NUMBER: _ClassVar[int]
    SECTORS_FIELD_NUMBER: _ClassVar[int]
    RANGE_MIN_M_FIELD_NUMBER: _ClassVar[int]
    RANGE_MAX_M_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_MIN_DEG_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_MAX_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_MIN_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_MAX_DEG_FIELD_NUMBER: _ClassVar[int]
    ACCURACIES_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    TRANSMITTERS_FIELD_NUMBER: _ClassVar[int]
    sensor: str
    time_utc: _timestamp_pb2.Timestamp
    type: str
    enabled: bool
    sac: int
    sic: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    altitude_m: float
    azimuth_reference: SensorDescription.AzimuthReference
    elevation_reference: SensorDescription.ElevationReference
    range_kind: SensorDescription.RangeKind
    scan_kind: str
    scan_period_s: float
    sectors: int
    range_min_m: float
    range_max_m: float
    azimuth_min_deg: float
    azimuth_max_deg: float
    elevation_min_deg: float
    elevation_max_deg: float
    accuracies: _containers.RepeatedCompositeFieldContainer[Accuracy]
    outputs: _containers.RepeatedCompositeFieldContainer[SensorOutput]
    transmitters: _containers.RepeatedCompositeFieldContainer[Transmitter]
    def __init__(self, sensor: _Optional[str] = ..., time_utc: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., type: _Optional[str] = ..., enabled: _Optional[bool] = ..., sac: _Optional[int] = ..., sic: _Optional[int] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_m: _Optional[float] = ..., altitude_m: _Optional[float] = ..., azimuth_reference: _Optional[_Union[SensorDescription.AzimuthReference, str]] = ..., elevation_reference: _Optional[_Union[SensorDescription.ElevationReference, str]] = ..., range_kind: _Optional[_Union[SensorDescription.RangeKind, str]] = ..., scan_kind: _Optional[str] = ..., scan_period_s: _Optional[float] = ..., sectors: _Optional[int] = ..., range_min_m: _Optional[float] = ..., range_max_m: _Optional[float] = ..., azimuth_min_deg: _Optional[float] = ..., azimuth_max_deg: _Optional[float] = ..., elevation_min_deg: _Optional[float] = ..., elevation_max_deg: _Optional[float] = ..., accuracies: _Optional[_Iterable[_Union[Accuracy, _Mapping]]] = ..., outputs: _Optional[_Iterable[_Union[SensorOutput, _Mapping]]] = ..., transmitters: _Optional[_Iterable[_Union[Transmitter, _Mapping]]] = ...) -> None: ...

class Accuracy(_message.Message):
    __slots__ = ("snr_db", "sigma_range_m", "sigma_bistatic_range_m", "sigma_azimuth_deg", "sigma_elevation_deg", "sigma_range_rate_m_s")
    SNR_DB_FIELD_NUMBER: _ClassVar[int]
    SIGMA_RANGE_M_FIELD_NUMBER: _ClassVar[int]
    SIGMA_BISTATIC_RANGE_M_FIELD_NUMBER: _ClassVar[int]
    SIGMA_AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    SIGMA_ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    SIGMA_RANGE_RATE_M_S_FIELD_NUMBER: _ClassVar[int]
    snr_db: float
    sigma_range_m: float
    sigma_bistatic_range_m: float
    sigma_azimuth_deg: float
    sigma_elevation_deg: float
    sigma_range_rate_m_s: float
    def __init__(self, snr_db: _Optional[float] = ..., sigma_range_m: _Optional[float] = ..., sigma_bistatic_range_m: _Optional[float] = ..., sigma_azimuth_deg: _Optional[float] = ..., sigma_elevation_deg: _Optional[float] = ..., sigma_range_rate_m_s: _Optional[float] = ...) -> None: ...

class SensorOutput(_message.Message):
    __slots__ = ("format", "topic", "content_type")
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    CONTENT_TYPE_FIELD_NUMBER: _ClassVar[int]
    format: str
    topic: str
    content_type: str
    def __init__(self, format: _Optional[str] = ..., topic: _Optional[str] = ..., content_type: _Optional[str] = ...) -> None: ...

class Transmitter(_message.Message):
    __slots__ = ("id", "channel", "latitude_deg", "longitude_deg", "height_m", "altitude_m", "frequency_hz")
    ID_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_M_FIELD_NUMBER: _ClassVar[int]
    FREQUENCY_HZ_FIELD_NUMBER: _ClassVar[int]
    id: str
    channel: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    altitude_m: float
    frequency_hz: float
    def __init__(self, id: _Optional[str] = ..., channel: _Optional[int] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_m: _Optional[float] = ..., altitude_m: _Optional[float] = ..., frequency_hz: _Optional[float] = ...) -> None: ...
