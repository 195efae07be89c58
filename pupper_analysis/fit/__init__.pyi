from .log import Log as Log
from .log import read_log as read_log
