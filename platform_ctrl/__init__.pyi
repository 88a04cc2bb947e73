from . import analysis as analysis
from . import campaign as campaign
from . import design as design
from . import export as export
from . import report as report
from . import simulation as simulation
from . import verification as verification
from .design.methods import read_job as read_job
from .errors import PlatformCtrlError as PlatformCtrlError
from .mechanics.equations import forward_dynamics as forward_dynamics
from .mechanics.equations import inverse_dynamics as inverse_dynamics
from .mechanics.equations import with_free_rotors as with_free_rotors
from .mechanics.equations import with_regulated_rotors as with_regulated_rotors
from .mechanics.forces import element_forces as element_forces
from .mechanics.linearisation import linearise as linearise
from .mechanics.matrices import matrices as matrices
from .mechanics.parameter_varying import parameter_varying as parameter_varying
from .mechanics.precession import precession as precession
from .mechanics.state_space import state_space as state_space
from .mechanics.state_space import subsystems as subsystems
from .mechanics.symbolic import equations as equations
from .mechanics.terms import terms as terms
from .plant.platform import Platform as Platform
from .plant.reading import read_platform as read_platform
from .plant.source import platform_source as platform_source
from .plant.source import shipped_models as shipped_models

__version__: str
