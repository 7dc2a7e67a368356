"""What is in the world and where we look from: shapes, meshes, trajectories, the voxel grid."""
