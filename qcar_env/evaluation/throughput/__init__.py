"""How fast cars are stepped, against other environments and the processor."""
