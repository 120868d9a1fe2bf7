// Part of RobotKube, not of FerretDB: the roles an account may have. See
// docs/decisions/0003-database-of-the-embedded-profile.md in RobotKube's repository.

package users

import (
	"fmt"

	"github.com/FerretDB/FerretDB/internal/types"
	"github.com/FerretDB/FerretDB/internal/util/must"
)

// Access is what a command needs; a higher value includes the lower ones.
type Access int

const (
	// AccessRead reads one database.
	AccessRead Access = iota + 1
	// AccessWrite reads and changes one database.
	AccessWrite
	// AccessRoot may do everything, accounts included.
	AccessRoot
)

// Role is a role's name and the database it is given on.
type Role struct {
	Name string
	DB   string
}

// RootRoles are the roles of the account made at set-up.
var RootRoles = []Role{{Name: "root", DB: "admin"}}

// granted maps the supported roles' names to what they give.
var granted = map[string]Access{
	"read":      AccessRead,
	"readWrite": AccessWrite,
	"root":      AccessRoot,
}

// ParseRoles reads the array of a createUser command or of a stored account, in MongoDB's two forms:
// {role: NAME, db: DATABASE} and NAME, which means the account's own database.
// Anything else is an error, also roles that MongoDB knows and this server does not.
func ParseRoles(array *types.Array, ownDB string) ([]Role, error) {
	roles := make([]Role, 0, array.Len())

	for i := range array.Len() {
		role := Role{DB: ownDB}

		switch v := must.NotFail(array.Get(i)).(type) {
		case string:
			role.Name = v
		case *types.Document:
			name, _ := v.Get("role")
			db, _ := v.Get("db")

			var nameOK, dbOK bool
			role.Name, nameOK = name.(string)
			role.DB, dbOK = db.(string)

			if !nameOK || !dbOK || v.Len() != 2 {
				return nil, fmt.Errorf("a role must be a name or {role: NAME, db: DATABASE}")
			}
		default:
			return nil, fmt.Errorf("a role must be a name or {role: NAME, db: DATABASE}")
		}

		access := granted[role.Name]

		switch {
		case access == 0:
			return nil, fmt.Errorf("role %q is not supported: use read, readWrite or root", role.Name)
		case (access == AccessRoot) != (role.DB == "admin"):
			return nil, fmt.Errorf("role %q cannot be given on database %q", role.Name, role.DB)
		case role.DB == "":
			return nil, fmt.Errorf("role %q needs a database", role.Name)
		}

		roles = append(roles, role)
	}

	return roles, nil
}

// RolesArray returns the stored form of roles.
func RolesArray(roles []Role) *types.Array {
	array := types.MakeArray(len(roles))
	for _, r := range roles {
		array.Append(must.NotFail(types.NewDocument("role", r.Name, "db", r.DB)))
	}

	return array
}

// Allow returns true if one of the roles gives the access on the database.
func Allow(roles []Role, db string, access Access) bool {
	for _, r := range roles {
		switch given := granted[r.Name]; {
		case given == AccessRoot && r.DB == "admin":
			return true
		case given != 0 && given != AccessRoot && given >= access && r.DB == db && db != "admin":
			return true
		}
	}

	return false
}
