"""What monoloc says in ROS 2 messages; nothing here imports ROS."""
