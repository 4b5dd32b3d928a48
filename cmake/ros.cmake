# The ROS layer: messages, conversions, bag reading, nodes.
find_package(catkin REQUIRED)
catkin_package()
