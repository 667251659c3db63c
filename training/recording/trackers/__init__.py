"""Experiment trackers behind one interface: TensorBoard, Weights & Biases, MLflow."""
