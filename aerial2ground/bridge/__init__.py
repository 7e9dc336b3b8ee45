"""Around the guard: the process of the policy and its camera, the car's file, a simulated car, and the evidence."""
