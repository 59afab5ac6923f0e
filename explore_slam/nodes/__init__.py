"""The ROS nodes: thin adapters between topics, parameters, services and the packages below."""
