"""Logs of robots, MCAP files and ROS 2 bags: read even if cut short; sessions are written as MCAP."""
