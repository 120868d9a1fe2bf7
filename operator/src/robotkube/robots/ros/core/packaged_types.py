"""The message types that the packaged images know, by package. Written by `make reference` from the
wheels of operator/requirements/robot.txt, which the image `ros` has; images of services are cut from it. A test says
when this module is not current, another compares it with the image."""

from __future__ import annotations

from collections.abc import Mapping

PACKAGED_IMAGES = frozenset(
    {
        "bag-player",
        "event-detector",
        "mqtt-bridge",
        "object-detection",
        "object-tracking",
        "ros",
    }
)

PACKAGED_TYPES: Mapping[str, str] = {
    "action_msgs": "GoalInfo GoalStatus GoalStatusArray",
    "builtin_interfaces": "Duration Time",
    "geometry_msgs": (
        "Accel AccelStamped AccelWithCovariance AccelWithCovarianceStamped Inertia InertiaStamped Point Point32 "
        "PointStamped Polygon PolygonInstance PolygonInstanceStamped PolygonStamped Pose Pose2D PoseArray PoseStamped "
        "PoseWithCovariance PoseWithCovarianceStamped Quaternion QuaternionStamped Transform TransformStamped Twist "
        "TwistStamped TwistWithCovariance TwistWithCovarianceStamped Vector3 Vector3Stamped VelocityStamped Wrench "
        "WrenchStamped"
    ),
    "lifecycle_msgs": "State Transition TransitionDescription TransitionEvent",
    "nav_msgs": "Goals GridCells MapMetaData OccupancyGrid Odometry Path",
    "rcl_interfaces": (
        "FloatingPointRange IntegerRange ListParametersResult Log LoggerLevel Parameter ParameterDescriptor "
        "ParameterEvent ParameterEventDescriptors ParameterType ParameterValue SetLoggerLevelsResult "
        "SetParametersResult"
    ),
    "rmw_dds_common": "Gid NodeEntitiesInfo ParticipantEntitiesInfo",
    "rosgraph_msgs": "Clock",
    "sensor_msgs": (
        "BatteryState CameraInfo ChannelFloat32 CompressedImage FluidPressure Illuminance Image Imu JointState Joy "
        "JoyFeedback JoyFeedbackArray LaserEcho LaserScan MagneticField MultiDOFJointState MultiEchoLaserScan "
        "NavSatFix NavSatStatus PointCloud PointCloud2 PointField Range RegionOfInterest RelativeHumidity Temperature "
        "TimeReference"
    ),
    "service_msgs": "ServiceEventInfo",
    "std_msgs": (
        "Bool Byte ByteMultiArray Char ColorRGBA Empty Float32 Float32MultiArray Float64 Float64MultiArray Header "
        "Int16 Int16MultiArray Int32 Int32MultiArray Int64 Int64MultiArray Int8 Int8MultiArray MultiArrayDimension "
        "MultiArrayLayout String UInt16 UInt16MultiArray UInt32 UInt32MultiArray UInt64 UInt64MultiArray UInt8 "
        "UInt8MultiArray"
    ),
    "type_description_interfaces": "Field FieldType IndividualTypeDescription KeyValue TypeDescription TypeSource",
    "unique_identifier_msgs": "UUID",
}
"""Package -> its messages, separated by spaces."""
