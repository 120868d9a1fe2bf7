"""The path of a pose between ROS and broker: bridges, and the end that receives."""
