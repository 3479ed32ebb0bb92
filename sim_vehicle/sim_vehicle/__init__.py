"""What the car really does: tyres, masses, air, actuators and a driver, with or without ROS."""
