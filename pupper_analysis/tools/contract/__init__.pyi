from .contract import Contract as Contract
from .contract import read_contract as read_contract
