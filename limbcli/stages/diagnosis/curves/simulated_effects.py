from limbcli.effects.ingredients import Ingredients as Ingredients  # until their users name that module
from limbcli.effects.ingredients import touches_loads as touches_loads
