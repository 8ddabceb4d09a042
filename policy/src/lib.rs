//! Learned policies: perception, networks, checkpoints, datasets, training.
