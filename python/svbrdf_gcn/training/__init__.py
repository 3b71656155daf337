"""Training of the networks with PyTorch: ``python -m svbrdf_gcn.training CONFIG -o FOLDER``, see docs/training.md.

``TrainingData`` draws what a network is trained on, and needs numpy alone. The modules here need what ``pip install 'svbrdf-gcn[training]'`` brings.
"""

from .._svbrdf_gcn import TrainingData

__all__ = ["TrainingData"]
