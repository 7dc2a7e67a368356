"""From channel impulse responses to images, continuous and binary; knows nothing of ground truth."""
