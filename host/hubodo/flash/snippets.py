"""Python code that a board runs at its prompt during flashing; the host fills in the {} fields."""

IDENTIFY = (
    "import sys;i=sys.implementation;"
    "print([sys.platform,getattr(i,'_machine',''),getattr(i,'_mpy',0),tuple(i.version[:3]),sys.version])"
)
SERIAL = "import machine,binascii;print(binascii.hexlify((bytes(machine.unique_id())+bytes(8))[:8]).decode())"
# Reads each file in small chunks into one buffer, as a node has little memory.
HASH_FUNCTION = """
import os,hashlib,binascii
b=bytearray(512)
m=memoryview(b)
def sha(n):
    h=hashlib.sha256()
    with open(n,'rb') as f:
        while True:
            k=f.readinto(b)
            if not k:
                return binascii.hexlify(h.digest()).decode()
            h.update(m[:k])
"""
LIST_HASHES = (
    HASH_FUNCTION
    + """
def walk(d):
    for e in list(os.ilistdir(d or '/')):
        n=d+'/'+e[0]
        if not e[1]&0x4000:
            print('# %s %s'%(sha(n),n))
        elif n in {folders}:
            walk(n)
walk('')
try:
    print(open('/main.py').read())
except OSError:
    pass
"""
)
PREPARE = """
import os
for n in {folders}:
    try:
        os.mkdir(n)
    except OSError:
        pass
for n in {remove}:
    os.remove(n)
b=bytearray(512)
m=memoryview(b)
for a,z in {copy}:
    with open(a,'rb') as f:
        with open(z,'wb') as g:
            while True:
                k=f.readinto(b)
                if not k:
                    break
                g.write(m[:k])
"""
SWAP = """
import os
for n in {swap}:
    os.rename('/'+n+'{new}','/'+n)
for n in {forget}:
    os.remove(n)
for n in {folders}:
    try:
        os.rmdir(n)
    except OSError:
        pass
"""
RECEIVE_FILE = """
import sys
def take(n,z):
    with open(n,'wb') as f:
        while z:
            k=min(z,{piece})
            sys.stdout.write({wanted})
            f.write(bytes.fromhex(sys.stdin.read(2*k)))
            z-=k
"""
ROLL_BACK = """
import os
t=open('/main.py').read()
with open('/main.py{new}','w') as f:
    f.write(t.replace({now!r},{then!r}))
os.rename('/main.py{new}','/main.py')
"""
# The pause lets the host close the port.
RESET = "import machine,time;time.sleep_ms(100);machine.reset()"
