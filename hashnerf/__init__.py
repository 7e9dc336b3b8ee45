"""The shared radiance-field core: cameras, posed images, hash grid, occupancy, volume rendering, fitting."""
