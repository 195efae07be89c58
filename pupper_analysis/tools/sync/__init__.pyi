from .models import Sync as Sync
