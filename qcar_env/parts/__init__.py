"""What a car is made of: springs, dampers, tyres, actuators, sensors. A new one is a new class."""
