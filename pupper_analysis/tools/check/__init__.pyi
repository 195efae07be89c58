from .check import RepositoryCheck as RepositoryCheck
from .check import check_repository as check_repository
