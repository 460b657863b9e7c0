from .characters.bundle import load_animated as load_animated
from .characters.bundle import load_character as load_character
from .characters.character import Character as Character
from .characters.character import assemble as assemble
from .characters.motion import Motion as Motion
from .characters.motion import load_motion as load_motion
from .characters.motion import random_motion as random_motion
from .characters.saving import save_character as save_character
from .geometry.rig_weights import solve_weights as solve_weights
from .geometry.skeleton import Skeleton as Skeleton
from .geometry.weight_transfer import transfer_weights as transfer_weights
from .methods.registry import method_of as method_of
from .models.evaluation import evaluate as evaluate
from .models.fitting import fit as fit
from .models.model import Model as Model
from .models.model import load_model as load_model

__version__: str
