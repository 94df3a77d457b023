"""The paper's equations: car, road, forces, integration, and the linear truth."""
