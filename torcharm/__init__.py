"""torcharm: can a soft continuum arm do the job? Attainability from a model, with gradients.

Indices of nodes, actuators, segments and loads count from 0, in tensors, arguments and the brackets of error messages.
Words, tables, figures and study files count from 1, the base's.
"""

import lazy_loader

# The public names and where they stand are those of `__init__.pyi`. Each loads when it is first used, so that the
# command is there before torch is.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.1.0"
